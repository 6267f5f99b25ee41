"""WiFi delay laws with the paper's mean delays."""

import random
from collections.abc import Mapping
from dataclasses import dataclass
from math import log

from benchmarks.simulated.links import Link
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


def _link(law: type[GammaDelay], shape: float) -> Link:
    return Link(
        law(479_000, MEAN_TO_LEADER_NS, shape, LATE_FRACTION, LATE_NS),
        law(517_000, MEAN_TO_CLIENT_NS, shape, LATE_FRACTION, LATE_NS),
    )


LINKS_BY_LAW: Mapping[str, Link] = {
    "paper": PAPER_LINK,
    "gamma 1": _link(GammaDelay, 1.0),
    "gamma 1.5": _link(GammaDelay, 1.5),
    "gamma 2": _link(GammaDelay, 2.0),
    "gamma 3": _link(GammaDelay, 3.0),
    "lognormal 0.6": _link(LognormalDelay, 0.6),
    "lognormal 1.0": _link(LognormalDelay, 1.0),
}
"""All laws of a WiFi link, by name: the first from Ansari et al. 2019, table III and supplement.

The others are assumed above floors of 479 and 517 us, the quickest message of all. They have at most the
paper's mean delays.
"""
