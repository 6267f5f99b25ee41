"""A radio channel that several links share: datagrams wait in one queue."""

import random
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class SharedMedium:
    """One radio channel for all links that name it: datagrams queue, with those of other networks."""

    airtime_ns: int = 300_000
    foreign_load: float = 0.3
    """Share of the time that other networks use, in datagrams of the same length at random times."""


class MediumQueue:
    """The queue of a medium in use."""

    def __init__(self, medium: SharedMedium) -> None:
        self.medium = medium
        self._at_true_ns = 0.0
        self._work_ns = 0.0

    def enter(self, true_ns: int, rng: random.Random) -> int:
        """Queue a datagram at a true time in ns, no earlier than the last; return when it has left, in ns."""
        airtime_ns = self.medium.airtime_ns
        if self.medium.foreign_load > 0.0:
            # An idle stretch longer than this has been forgotten.
            self._at_true_ns = max(self._at_true_ns, true_ns - 200.0 * airtime_ns)
            rate = self.medium.foreign_load / airtime_ns
            while (gap_ns := rng.expovariate(rate)) <= true_ns - self._at_true_ns:
                self._pass(gap_ns)
                self._work_ns += airtime_ns
        self._pass(true_ns - self._at_true_ns)
        self._work_ns += airtime_ns
        return round(true_ns + self._work_ns)

    def _pass(self, gap_ns: float) -> None:
        self._work_ns = max(0.0, self._work_ns - gap_ns)
        self._at_true_ns += gap_ns
