"""Laws of one-way delays: Gamma, lognormal, rarely quick, or recorded; times in ns."""

import random
from dataclasses import dataclass
from math import log
from typing import Protocol


class DelayLaw(Protocol):
    """A law of one-way delays."""

    def draw(self, rng: random.Random, true_ns: int = 0) -> int:
        """Return the delay in ns of one datagram sent at a true time in ns."""


@dataclass(frozen=True, slots=True)
class GammaDelay:
    """One-way delay = minimum + Gamma(shape) of the mean given, times in ns; some come much later."""

    minimum_ns: int
    mean_ns: int
    """Of all but those that come much later."""
    shape: float = 2.0
    outlier_share: float = 0.0
    outlier_from_ns: int = 0
    outlier_ns: int = 20_000_000
    """So much later at most, evenly from `outlier_from_ns` on."""

    def draw(self, rng: random.Random, true_ns: int = 0) -> int:
        """Return the delay of one datagram, in ns."""
        scale_ns = (self.mean_ns - self.minimum_ns) / self.shape
        if self.shape == 2.0:
            # The sum of two exponentials, which is drawn faster.
            excess_ns = -scale_ns * log((1.0 - rng.random()) * (1.0 - rng.random()))
        else:
            excess_ns = rng.gammavariate(self.shape, scale_ns)
        return round(self.minimum_ns + excess_ns + _outlier_ns(self, rng))


@dataclass(frozen=True, slots=True)
class LognormalDelay:
    """One-way delay = minimum + lognormal(sigma) of the mean given, times in ns; some come much later."""

    minimum_ns: int
    mean_ns: int
    sigma: float = 1.0
    outlier_share: float = 0.0
    outlier_from_ns: int = 0
    outlier_ns: int = 20_000_000

    def draw(self, rng: random.Random, true_ns: int = 0) -> int:
        """Return the delay of one datagram, in ns."""
        excess_ns = rng.lognormvariate(log(self.mean_ns - self.minimum_ns) - self.sigma**2 / 2.0, self.sigma)
        return round(self.minimum_ns + excess_ns + _outlier_ns(self, rng))


@dataclass(frozen=True, slots=True)
class BimodalDelay:
    """Now and then a quick one, near the minimum; most wait for `gap_ns` and Gamma(2) more. Times in ns."""

    minimum_ns: int
    mean_ns: int
    """Of those that wait."""
    quick_share: float
    gap_ns: int
    quick_ns: int = 20_000
    """Mean of the exponential delay of the quick ones beyond the minimum."""

    def draw(self, rng: random.Random, true_ns: int = 0) -> int:
        """Return the delay of one datagram, in ns."""
        if rng.random() < self.quick_share:
            return round(self.minimum_ns + rng.expovariate(1.0 / self.quick_ns))
        least_ns = self.minimum_ns + self.gap_ns
        return round(least_ns + rng.gammavariate(2.0, (self.mean_ns - least_ns) / 2.0))


@dataclass(frozen=True, slots=True)
class ReplayedDelay:
    """Recorded delays in ns, a new one each `every_ns` of true time, over and over, from `start` on."""

    delays_ns: tuple[int, ...]
    every_ns: int
    start: int = 0

    def draw(self, rng: random.Random, true_ns: int = 0) -> int:
        """Return the delay that was recorded at that time, in ns."""
        return self.delays_ns[(self.start + true_ns // self.every_ns) % len(self.delays_ns)]


def _outlier_ns(law: GammaDelay | LognormalDelay, rng: random.Random) -> float:
    if rng.random() >= law.outlier_share:
        return 0.0
    return law.outlier_from_ns + rng.random() * (law.outlier_ns - law.outlier_from_ns)
