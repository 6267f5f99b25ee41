"""Links that are drawn anew for each trial: how unequal their two ways are, no exchange can see."""

import random
from collections.abc import Callable
from dataclasses import replace

from capture_app.simulation.links import (
    BimodalDelay,
    DelayLaw,
    GammaDelay,
    Link,
    LognormalDelay,
    ReplayedDelay,
    TroubleSpells,
)
from capture_app.simulation.paper_link import LINKS_BY_LAW, PAPER_LINK

HALF_LEAST_NS = 498_000
"""Half the least round trip of the paper's link: no more than this can an asymmetry be."""
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
    floors = link if link.quick is None else link.quick
    there_ns = half_ns + shift_ns - _minimum(floors.to_leader)
    back_ns = half_ns - shift_ns - _minimum(floors.to_client)
    quick = link.quick
    if quick is not None:
        to_leader, to_client = _moved(quick.to_leader, there_ns), _moved(quick.to_client, back_ns)
        quick = replace(quick, to_leader=to_leader, to_client=to_client)
    to_leader, to_client = _moved(link.to_leader, there_ns), _moved(link.to_client, back_ns)
    return replace(link, to_leader=to_leader, to_client=to_client, quick=quick)


def unequal_links(law: str) -> DrawLink:
    """Links under one of the laws."""
    return lambda rng: unequal(LINKS_BY_LAW[law], rng)


def any_law(rng: random.Random, share: float = ASYMMETRY) -> Link:
    """The paper's mean delays, under one of the laws of a WiFi link."""
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


def _minimum(law: DelayLaw) -> int:
    assert isinstance(law, GammaDelay | LognormalDelay | BimodalDelay)
    return law.minimum_ns


def _moved(law: DelayLaw, by_ns: int) -> DelayLaw:
    """The same law with its minimum and mean moved."""
    assert isinstance(law, GammaDelay | LognormalDelay | BimodalDelay)
    return replace(law, minimum_ns=law.minimum_ns + by_ns, mean_ns=law.mean_ns + by_ns)
