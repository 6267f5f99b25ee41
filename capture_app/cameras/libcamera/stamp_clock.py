"""Which clock libcamera stamps in, and its stamps in the host's monotonic clock.

Its documentation says CLOCK_BOOTTIME; where the kernel's V4L2 stamps, it is CLOCK_MONOTONIC. The two part
while the machine sleeps, and not otherwise.
"""

import time
from collections.abc import Callable

_NOISE_NS = 1_000_000
"""Two readings, one after the other, differ by less, and a sleep is longer."""
_FOREIGN_NS = 60_000_000_000
"""A stamp this far from now is of neither clock."""


class StampClock:
    """Brings stamps into the monotonic clock; both clocks can be others in a test."""

    def __init__(
        self,
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
        boot_ns: Callable[[], int] = lambda: time.clock_gettime_ns(time.CLOCK_BOOTTIME),
    ) -> None:
        self._monotonic_ns, self._boot_ns = monotonic_ns, boot_ns
        self._asleep_ns = 0

    def now_ns(self) -> int:
        """The monotonic clock now."""
        return self._monotonic_ns()

    def monotonic_of(self, stamp_ns: int) -> int | None:
        """The time in ns of a stamp that has just come; None where it is of another clock."""
        now_ns = self._monotonic_ns()
        asleep_ns = self._boot_ns() - now_ns
        if abs(asleep_ns - self._asleep_ns) > _NOISE_NS:
            self._asleep_ns = asleep_ns
        by_boot_ns = stamp_ns - self._asleep_ns
        nearest_ns = min(stamp_ns, by_boot_ns, key=lambda ns: abs(now_ns - ns))
        return nearest_ns if abs(now_ns - nearest_ns) < _FOREIGN_NS else None
