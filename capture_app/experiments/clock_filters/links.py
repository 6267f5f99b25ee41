"""Links that are drawn anew for each trial: how unequal their two ways are, no exchange can see."""

import random
from collections.abc import Callable
from dataclasses import replace

from capture_app.simulation.network.delay_laws import (
    BimodalDelay,
    DelayLaw,
    GammaDelay,
    LognormalDelay,
    ReplayedDelay,
)
from capture_app.simulation.network.link import Link, TroubleSpells
from capture_app.simulation.network.paper_link import LINKS_BY_LAW, PAPER_LINK

HALF_LEAST_NS = 498_000
"""Half the least round trip of the paper's link."""
ASYMMETRY = 0.05
"""One sigma of half the difference of the least delays, as a share of half the least round trip."""
_CABLE = Link(GammaDelay(50_000, 60_000), GammaDelay(50_000, 60_000))
_SPELLS = TroubleSpells(calm_ns=1_000_000_000, trouble_ns=1_000_000_000, extra_ns=15_000_000)
_RARELY_QUICK = Link(
    BimodalDelay(HALF_LEAST_NS, 1_878_000, quick_share=0.045, gap_ns=450_000),
    BimodalDelay(HALF_LEAST_NS, 1_133_000, quick_share=0.045, gap_ns=450_000),
)

DrawLink = Callable[[random.Random], Link]


def unequal(
    link: Link, rng: random.Random, *, half_ns: int = HALF_LEAST_NS, share: float = ASYMMETRY
) -> Link:
    """Return a link with this half of the least round trip, whose least delays differ by chance."""
    shift_ns = round(rng.gauss(0.0, share * half_ns))
    to_leader = _with_minimum(link.to_leader, half_ns + shift_ns)
    return replace(link, to_leader=to_leader, to_client=_with_minimum(link.to_client, half_ns - shift_ns))


def unequal_links(law: str) -> DrawLink:
    """Links under one of the six laws."""
    return lambda rng: unequal(LINKS_BY_LAW[law], rng)


def any_law(rng: random.Random, share: float = ASYMMETRY) -> Link:
    """The paper's mean delays, under one of the six laws."""
    return unequal(LINKS_BY_LAW[rng.choice(list(LINKS_BY_LAW))], rng, share=share)


def cable(rng: random.Random) -> Link:
    """A cable with a switch: 50 us each way, and 10 more on average."""
    return unequal(_CABLE, rng, half_ns=50_000)


def bursty(rng: random.Random) -> Link:
    """The paper's link with 5 % loss, half of the time in trouble: 15 ms more each way, and a third lost."""
    return unequal(replace(PAPER_LINK, loss=0.05, spells=_SPELLS), rng)


def rarely_quick(rng: random.Random) -> Link:
    """The paper's mean delays, but one message in 22 only is near the least delay of its way."""
    return unequal(_RARELY_QUICK, rng)


def replayed(link: Link) -> DrawLink:
    """Links that replay a recording from a random place on."""

    def draw(rng: random.Random) -> Link:
        assert isinstance(link.to_leader, ReplayedDelay)
        assert isinstance(link.to_client, ReplayedDelay)
        start = rng.randrange(len(link.to_leader.delays_ns))
        return Link(replace(link.to_leader, start=start), replace(link.to_client, start=start))

    return draw


def _with_minimum(law: DelayLaw, minimum_ns: int) -> DelayLaw:
    """The same law with another minimum, and the mean moved with it."""
    assert isinstance(law, GammaDelay | LognormalDelay | BimodalDelay)
    return replace(law, minimum_ns=minimum_ns, mean_ns=law.mean_ns + minimum_ns - law.minimum_ns)
