"""Network links in virtual time: laws of one-way delays, and loss; true times are the simulation's.

A link with a memory, as WiFi has it, gives each node that opens it a channel of its own.
"""

import random
from dataclasses import dataclass
from math import log
from typing import Literal, Protocol


class DelayLaw(Protocol):
    """A law of one-way delays."""

    def draw(self, rng: random.Random, true_ns: int = 0) -> int:
        """Return the delay in ns of one datagram sent at a true time in ns."""


@dataclass(frozen=True, slots=True)
class GammaDelay:
    """One-way delay = minimum + Gamma(shape) of the mean given, times in ns; some come much later."""

    minimum_ns: int
    mean_ns: int
    """The mean of all but those that come much later."""
    shape: float = 2.0
    outlier_share: float = 0.0
    outlier_from_ns: int = 0
    outlier_ns: int = 20_000_000
    """The most that one comes later, evenly from `outlier_from_ns` on."""

    def draw(self, rng: random.Random, true_ns: int = 0) -> int:
        """Return the delay of one datagram, in ns."""
        scale_ns = (self.mean_ns - self.minimum_ns) / self.shape
        if self.shape == 2.0:
            # The sum of two exponentials, which is drawn faster.
            excess_ns = -scale_ns * log((1.0 - rng.random()) * (1.0 - rng.random()))
        else:
            excess_ns = rng.gammavariate(self.shape, scale_ns)
        return round(self.minimum_ns + excess_ns + self.draw_outlier_ns(rng))

    def draw_outlier_ns(self, rng: random.Random) -> float:
        """Return how much later one datagram comes than the law says; mostly not at all."""
        if rng.random() >= self.outlier_share:
            return 0.0
        return self.outlier_from_ns + rng.random() * (self.outlier_ns - self.outlier_from_ns)


@dataclass(frozen=True, slots=True)
class ReplayedDelay:
    """Recorded delays in ns, a new one each `every_ns` of true time, over and over, from `start` on."""

    delays_ns: tuple[int, ...]
    every_ns: int
    start: int = 0

    def draw(self, rng: random.Random, true_ns: int = 0) -> int:
        """Return the delay that was recorded at that time, in ns."""
        return self.delays_ns[(self.start + true_ns // self.every_ns) % len(self.delays_ns)]


Direction = Literal["to_leader", "to_client"]


class Channel(Protocol):
    """A link in use by one node."""

    def deliveries(self, direction: Direction, true_ns: int, rng: random.Random) -> list[int]:
        """Return the delays in ns at which copies of one datagram arrive: none, one or two."""


@dataclass(frozen=True, slots=True)
class Link:
    """A link between a client and its leader; datagrams can overtake each other."""

    to_leader: DelayLaw
    to_client: DelayLaw
    loss: float = 0.0
    duplication: float = 0.0

    def open(self) -> Channel:
        """Return the link as one node uses it from now on."""
        return self

    def deliveries(self, direction: Direction, true_ns: int, rng: random.Random) -> list[int]:
        """See `Channel.deliveries`."""
        if rng.random() < self.loss:
            return []
        copies = 2 if rng.random() < self.duplication else 1
        law = self.to_leader if direction == "to_leader" else self.to_client
        return [law.draw(rng, true_ns) for _ in range(copies)]


WIFI = Link(GammaDelay(845_000, 1_878_000), GammaDelay(883_000, 1_133_000))
"""A WiFi link of the delays that most messages of the paper have (`benchmarks/simulated/wireless.py`)."""
