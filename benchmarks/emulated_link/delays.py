"""Delays of an emulated link; `delay_laws.h` draws them."""

from dataclasses import dataclass
from typing import ClassVar

from benchmarks.simulated.links import DelayLaw
from benchmarks.simulated.wireless import (
    LATE_FRACTION,
    LATE_NS,
    PAPER_LINK,
    QUICK_AFTER_NS,
    QUICK_FRACTION,
    GammaDelay,
)


@dataclass(frozen=True, slots=True)
class Delays:
    """One-way delays in us: `constant` is the minimum; `gamma` and `lognormal` have this total mean.

    `shape` is the shape of the Gamma law, or the sigma of the lognormal. `rare` is a Gamma law of that total
    mean from `wait_us` above the minimum on. In quick moments it is exponential from the minimum on, with
    mean `quick_us`.
    """

    minimum_us: float
    mean_us: float
    law: str = "gamma"
    shape: float = 2.0
    wait_us: float = 0.0
    quick_us: float = 0.0

    def __str__(self) -> str:
        """Return the emulator's notation for it."""
        if self.law == "constant":
            return f"constant,{self.minimum_us}"
        word = f"{self.law},{self.minimum_us},{self.mean_us},{self.shape}"
        return f"{word},{self.wait_us},{self.quick_us}" if self.law == "rare" else word


def _rarely_quick(most: DelayLaw, quick: DelayLaw) -> Delays:
    assert isinstance(most, GammaDelay)
    assert isinstance(quick, GammaDelay)
    minimum_us = quick.minimum_ns / 1000.0
    return Delays(
        minimum_us,
        most.mean_ns / 1000.0,
        "rare",
        most.shape,
        wait_us=most.minimum_ns / 1000.0 - minimum_us,
        quick_us=quick.mean_ns / 1000.0 - minimum_us,
    )


assert PAPER_LINK.quick is not None
TO_LEADER = _rarely_quick(PAPER_LINK.to_leader, PAPER_LINK.quick.to_leader)
TO_CLIENT = _rarely_quick(PAPER_LINK.to_client, PAPER_LINK.quick.to_client)
"""WiFi as measured in the paper; `benchmarks/simulated/wireless.py` lists the assumptions."""
IDLE_US = 200_000
"""Idle time after which a link is as slow as a fresh one.

Each trial of a benchmark thus finds the link as a phone does that has just joined.
"""


@dataclass(frozen=True, slots=True)
class EmulatedLink:
    """A link between two ends, `NAMESPACE/DEVICE`, with the delays of its two directions."""

    OPTIONS: ClassVar[tuple[str, ...]] = (
        *("-o", f"{LATE_FRACTION}", "-f", f"{LATE_NS / 1000:.0f}", "-u", "20000"),
        *("-q", f"{QUICK_FRACTION}", "-a", f"{QUICK_AFTER_NS / 1000:.0f}", "-i", f"{IDLE_US}"),
    )
    """Fractions of frames that arrive 10 to 20 ms later still, and of quick moments."""

    leader: str
    client: str
    to_leader: Delays = TO_LEADER
    to_client: Delays = TO_CLIENT

    def words(self) -> tuple[str, str, str, str]:
        """Return the emulator's arguments for it."""
        return self.leader, self.client, str(self.to_leader), str(self.to_client)

    def ways(self) -> tuple[tuple[str, Delays], tuple[str, Delays]]:
        """Return the receivers with their delays, in the order of the emulator's reports."""
        return ("leader", self.to_leader), ("client", self.to_client)
