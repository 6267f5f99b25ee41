"""WiFi delay laws with the paper's mean delays, their sources, and their required statistics."""

import random
from collections.abc import Mapping
from dataclasses import dataclass
from math import log

from benchmarks.simulated.links import DelayLaw, Link
from benchmarks.simulated.wireless import (
    LATE_FRACTION,
    LATE_NS,
    MEAN_TO_CLIENT_NS,
    MEAN_TO_LEADER_NS,
    PAPER_LINK,
    GammaDelay,
)

LOOPBACK = Link(GammaDelay(30_000, 45_000), GammaDelay(30_000, 45_000))
"""From the leader's own camera to the leader: another process of the same machine."""


@dataclass(frozen=True, slots=True)
class LognormalDelay(GammaDelay):
    """One-way delay = minimum + lognormal of the mean given, times in ns; some come much later."""

    shape: float = 1.0
    """Sigma of the delay's logarithm."""

    def draw(self, rng: random.Random, true_ns: int = 0) -> int:
        """Return the delay of one datagram, in ns."""
        excess_ns = rng.lognormvariate(log(self.mean_ns - self.minimum_ns) - self.shape**2 / 2.0, self.shape)
        return round(self.minimum_ns + excess_ns + self.draw_outlier_ns(rng))


@dataclass(frozen=True, slots=True)
class BimodalDelay:
    """Mostly delays of `gap_ns` and Gamma(2) more; now and then a quick one near the minimum. Times in ns."""

    minimum_ns: int
    mean_ns: int
    """Mean of the delays that are not quick."""
    quick_fraction: float
    gap_ns: int
    quick_ns: int = 20_000
    """Mean of the quick ones' exponential delay beyond the minimum."""

    def draw(self, rng: random.Random, true_ns: int = 0) -> int:
        """Return the delay of one datagram, in ns."""
        if rng.random() < self.quick_fraction:
            return round(self.minimum_ns + rng.expovariate(1.0 / self.quick_ns))
        min_ns = self.minimum_ns + self.gap_ns
        return round(min_ns + rng.gammavariate(2.0, (self.mean_ns - min_ns) / 2.0))


@dataclass(frozen=True, slots=True)
class LinkStatistics:
    """Required statistics of a link in us, a message per POLL_INTERVAL_NS; without round trips over 10 ms."""

    mean_to_leader_us: float
    mean_to_client_us: float
    min_round_trip_us: Mapping[int, float]
    """Mean over trials, by the number of messages."""
    late_fraction: float = 2 * LATE_FRACTION
    """Fraction of the round trips over 10 ms."""


@dataclass(frozen=True, slots=True)
class SourcedLink:
    """A link, the source of its law, and the statistics that this source or assumption requires."""

    link: Link
    source: str
    statistics: LinkStatistics


def _assumed(name: str, laws: tuple[DelayLaw, DelayLaw], statistics: LinkStatistics) -> SourcedLink:
    """Return a law with its minima at the quickest message of all; its statistics follow from that."""
    source = f"assumed: mean delays as in Ansari et al. 2019, floors of 479 and 517 us, {name}"
    return SourcedLink(Link(*laws), source, statistics)


def _gamma_link(shape: float, statistics: LinkStatistics) -> SourcedLink:
    laws = (
        GammaDelay(479_000, MEAN_TO_LEADER_NS, shape, LATE_FRACTION, LATE_NS),
        GammaDelay(517_000, MEAN_TO_CLIENT_NS, shape, LATE_FRACTION, LATE_NS),
    )
    return _assumed(f"Gamma of shape {shape:g}", laws, statistics)


def _lognormal_link(sigma: float, statistics: LinkStatistics) -> SourcedLink:
    laws = (
        LognormalDelay(479_000, MEAN_TO_LEADER_NS, sigma, LATE_FRACTION, LATE_NS),
        LognormalDelay(517_000, MEAN_TO_CLIENT_NS, sigma, LATE_FRACTION, LATE_NS),
    )
    return _assumed(f"lognormal of {sigma:g}", laws, statistics)


def _statistics(
    min_us: tuple[float, float, float],
    mean_us: tuple[float, float] = (MEAN_TO_LEADER_NS / 1e3, MEAN_TO_CLIENT_NS / 1e3),
    late_fraction: float = 2 * LATE_FRACTION,
) -> LinkStatistics:
    return LinkStatistics(*mean_us, dict(zip((300, 1000, 10_000), min_us, strict=True)), late_fraction)


LINKS: Mapping[str, SourcedLink] = {
    "paper": SourcedLink(
        PAPER_LINK,
        "Ansari et al. 2019, table III and supplement",
        _statistics((1870.0, 1020.0, 996.0)),
    ),
    "gamma 1": _gamma_link(1.0, _statistics((1067.0, 1032.0, 1006.0), (1864.0, 1132.0), 0.0092)),
    "gamma 1.5": _gamma_link(1.5, _statistics((1165.0, 1098.0, 1053.0))),
    "gamma 2": _gamma_link(2.0, _statistics((1252.0, 1179.0, 1097.0))),
    "gamma 3": _gamma_link(3.0, _statistics((1406.0, 1316.0, 1214.0))),
    "lognormal 0.6": _lognormal_link(0.6, _statistics((1509.0, 1431.0, 1320.0))),
    "lognormal 1.0": _lognormal_link(1.0, _statistics((1172.0, 1133.0, 1072.0), (1755.0, 1114.0), 0.0187)),
}
"""All laws of a WiFi link, by name; all but the first meet at most the means of the paper's figures."""
LINKS_BY_LAW: Mapping[str, Link] = {name: sourced.link for name, sourced in LINKS.items()}
