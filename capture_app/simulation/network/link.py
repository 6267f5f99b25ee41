"""Network links in virtual time: laws of one-way delays, loss, bursts, a shared medium, outages.

A `Link` is data; a `Channel` is one node's use of it, with the memory that bursts and queues have. True
times are those of the simulation, in ns.
"""

import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import log
from typing import Literal, Protocol

Crossing = Callable[[random.Random], Sequence[int]]
"""Draws the delays in ns at which copies of one datagram arrive: none, one or two."""


_US = 1_000
_S = 1_000_000_000
Direction = Literal["to_leader", "to_client"]


class Law(Protocol):
    """A law of one-way delays."""

    def draw(self, rng: random.Random, true_ns: int = 0) -> int:
        """Return the delay in ns of one datagram sent at a true time in ns."""


@dataclass(frozen=True, slots=True)
class DelayLaw:
    """One-way delay = minimum + Gamma(shape) of the mean given, times in ns; some come much later."""

    minimum_ns: int
    mean_ns: int
    shape: float = 2.0
    outlier_share: float = 0.0
    outlier_ns: int = 20_000_000

    def draw(self, rng: random.Random, true_ns: int = 0) -> int:
        """Return the delay of one datagram, in ns."""
        delay_ns = self.minimum_ns + rng.gammavariate(
            self.shape, (self.mean_ns - self.minimum_ns) / self.shape
        )
        if rng.random() < self.outlier_share:
            delay_ns += rng.random() * self.outlier_ns
        return round(delay_ns)


@dataclass(frozen=True, slots=True)
class LognormalLaw:
    """One-way delay = minimum + lognormal(sigma) of the mean given, times in ns; some come much later."""

    minimum_ns: int
    mean_ns: int
    sigma: float = 1.0
    outlier_share: float = 0.0
    outlier_ns: int = 20_000_000

    def draw(self, rng: random.Random, true_ns: int = 0) -> int:
        """Return the delay of one datagram, in ns."""
        middle = log(self.mean_ns - self.minimum_ns) - self.sigma**2 / 2.0
        delay_ns = self.minimum_ns + rng.lognormvariate(middle, self.sigma)
        if rng.random() < self.outlier_share:
            delay_ns += rng.random() * self.outlier_ns
        return round(delay_ns)


@dataclass(frozen=True, slots=True)
class ReplayedLaw:
    """Recorded delays in ns, a new one each `every_ns` of true time, over and over, from `start` on."""

    delays_ns: tuple[int, ...]
    every_ns: int
    start: int = 0

    def draw(self, rng: random.Random, true_ns: int = 0) -> int:
        """Return the delay that was recorded at that time, in ns."""
        return self.delays_ns[(self.start + true_ns // self.every_ns) % len(self.delays_ns)]


@dataclass(frozen=True, slots=True)
class Bursts:
    """Spells of trouble (Gilbert 1960): exponential of these means in ns, with more delay and loss."""

    calm_ns: int = 2 * _S
    trouble_ns: int = 200_000_000
    extra_ns: int = 8_000_000
    """Mean of the exponential delay that trouble adds, each way."""
    loss: float = 0.3


@dataclass(frozen=True, slots=True)
class Medium:
    """One channel of the air for all who share it: datagrams queue, among those of strangers."""

    airtime_ns: int = 300_000
    strangers: float = 0.3
    """Share of the time that others use, in datagrams of the same length that come by chance."""


@dataclass(frozen=True, slots=True)
class Outage:
    """Nothing passes from this true time on, for so long; both in ns."""

    start_true_ns: int
    duration_ns: int


class Air:
    """A medium in use: the work that waits in its queue."""

    def __init__(self, medium: Medium) -> None:
        self.medium = medium
        self._at_true_ns = 0.0
        self._work_ns = 0.0

    def enter(self, true_ns: int, rng: random.Random) -> int:
        """Queue a datagram at a true time in ns, no earlier than the last; return when it has left, in ns."""
        airtime_ns = self.medium.airtime_ns
        if self.medium.strangers > 0.0:
            # An idle stretch longer than this has been forgotten.
            self._at_true_ns = max(self._at_true_ns, true_ns - 200.0 * airtime_ns)
            rate = self.medium.strangers / airtime_ns
            while (gap_ns := rng.expovariate(rate)) <= true_ns - self._at_true_ns:
                self._pass(gap_ns)
                self._work_ns += airtime_ns
        self._pass(true_ns - self._at_true_ns)
        self._work_ns += airtime_ns
        return round(true_ns + self._work_ns)

    def _pass(self, gap_ns: float) -> None:
        self._work_ns = max(0.0, self._work_ns - gap_ns)
        self._at_true_ns += gap_ns


@dataclass(frozen=True, slots=True)
class Link:
    """A link between a client and its leader; datagrams overtake each other as their delays will."""

    to_leader: Law
    to_client: Law
    loss: float = 0.0
    duplication: float = 0.0
    bursts: Bursts | None = None
    medium: Medium | None = None
    outages: tuple[Outage, ...] = ()

    def deliveries(self, law: Law, rng: random.Random) -> list[int]:
        """Return the delays in ns at which copies of one datagram arrive, without any memory."""
        if rng.random() < self.loss:
            return []
        copies = 2 if rng.random() < self.duplication else 1
        return [law.draw(rng) for _ in range(copies)]


class Channel:
    """A link in use by one node; nodes that share a medium share its `Air`."""

    def __init__(self, link: Link, air: Air | None = None) -> None:
        self.link = link
        self._air = air if air is not None or link.medium is None else Air(link.medium)
        self._trouble = False
        self._turns_true_ns: float | None = None

    def deliveries(self, direction: Direction, true_ns: int, rng: random.Random) -> list[int]:
        """Return the delays in ns at which copies of one datagram arrive: none, one or two."""
        link = self.link
        if any(0 <= true_ns - o.start_true_ns < o.duration_ns for o in link.outages):
            return []
        extra_ns = 0.0
        if link.bursts is not None and self._in_trouble(link.bursts, true_ns, rng):
            if rng.random() < link.bursts.loss:
                return []
            extra_ns = rng.expovariate(1.0 / link.bursts.extra_ns)
        if rng.random() < link.loss:
            return []
        if self._air is not None:
            extra_ns += self._air.enter(true_ns, rng) - true_ns
        copies = 2 if rng.random() < link.duplication else 1
        law = link.to_leader if direction == "to_leader" else link.to_client
        return [law.draw(rng, true_ns) + round(extra_ns) for _ in range(copies)]

    def _in_trouble(self, bursts: Bursts, true_ns: int, rng: random.Random) -> bool:
        if self._turns_true_ns is None:
            self._turns_true_ns = true_ns + rng.expovariate(1.0 / bursts.calm_ns)
        while self._turns_true_ns <= true_ns:
            self._trouble = not self._trouble
            mean_ns = bursts.trouble_ns if self._trouble else bursts.calm_ns
            self._turns_true_ns += rng.expovariate(1.0 / mean_ns)
        return self._trouble


PAPER_LINK = Link(
    to_leader=DelayLaw(479 * _US, 1878 * _US, outlier_share=0.0064),
    to_client=DelayLaw(517 * _US, 1133 * _US, outlier_share=0.0064),
)
"""WiFi as the paper measured it (section 4); the Gamma shape is an assumption."""


def paper_link(shape: float | None = None, sigma: float | None = None, loss: float = 0.0) -> Link:
    """Return the paper's link with another law of delays: Gamma of a shape, or lognormal of a sigma."""

    def law(minimum_ns: int, mean_ns: int) -> Law:
        if sigma is not None:
            return LognormalLaw(minimum_ns, mean_ns, sigma, 0.0064)
        return DelayLaw(minimum_ns, mean_ns, 2.0 if shape is None else shape, 0.0064)

    return Link(law(479 * _US, 1878 * _US), law(517 * _US, 1133 * _US), loss)


LAWS: dict[str, Link] = {
    "gamma 1": paper_link(shape=1.0),
    "gamma 1.5": paper_link(shape=1.5),
    "gamma 2": paper_link(shape=2.0),
    "gamma 3": paper_link(shape=3.0),
    "lognormal 0.6": paper_link(sigma=0.6),
    "lognormal 1.0": paper_link(sigma=1.0),
}
"""The paper's minimum and mean delays under six laws; the paper gives none."""


def crossing(link: Link, law: Law) -> Crossing:
    """Return how datagrams of one direction cross: as `link.deliveries(law, rng)` says, drawn otherwise."""
    if link.loss or link.duplication or not isinstance(law, DelayLaw) or law.shape != 2.0:
        return lambda rng: link.deliveries(law, rng)
    minimum_ns, outlier_share, outlier_ns = law.minimum_ns, law.outlier_share, law.outlier_ns
    scale_ns = (law.mean_ns - minimum_ns) / 2.0

    def cross(rng: random.Random) -> tuple[int]:
        # Gamma of shape 2 is the sum of two exponentials.
        uniform = rng.random
        delay_ns = minimum_ns - scale_ns * log((1.0 - uniform()) * (1.0 - uniform()))
        if uniform() < outlier_share:
            delay_ns += uniform() * outlier_ns
        return (round(delay_ns),)

    return cross
