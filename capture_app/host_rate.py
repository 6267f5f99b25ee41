"""Whether this host is slewing its clock, as its own kernel tells; silently unknown where it does not.

An NTP daemon that corrects the time makes CLOCK_MONOTONIC, which stamps frames and messages, run faster or
slower for a while. CLOCK_MONOTONIC_RAW is the same hardware without that, and `adjtimex` tells which steady
correction of its frequency is in force (adjtimex(2), clock_gettime(2)).
"""

import ctypes
import sys
import time
from collections.abc import Callable

EVERY_NS = 4_000_000_000
"""Over so long two clocks that are read microseconds apart show their rates to about one ppm."""
READINGS = 5
SLEWED_PPM = 20.0
"""A correction of the rate beyond the steady one that is worth to be told."""
STEADY_PPM = 100.0
"""No ordinary crystal needs a steady correction of more: what is beyond is a time being corrected."""
USUAL_TICK_US = 10_000


class _Timex(ctypes.Structure):
    """The first fields of `struct timex`, and room for the rest."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("freq", ctypes.c_long),
        ("maxerror", ctypes.c_long),
        ("esterror", ctypes.c_long),
        ("status", ctypes.c_int),
        ("constant", ctypes.c_long),
        ("precision", ctypes.c_long),
        ("tolerance", ctypes.c_long),
        ("time", ctypes.c_long * 2),
        ("tick", ctypes.c_long),
        ("rest", ctypes.c_long * 32),
    )


def steady_correction_ppm() -> float | None:
    """Return the correction of the frequency that the kernel is told to apply; None where it does not say."""
    if not sys.platform.startswith("linux"):
        return None
    told = _Timex()
    try:
        if ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.byref(told)) < 0:
            return None
    except (OSError, AttributeError):
        return None
    tick, frequency = int(told.tick), int(told.freq)
    return (tick - USUAL_TICK_US) * 1e6 / USUAL_TICK_US + frequency / 65536.0


def read_clocks() -> tuple[int, int] | None:
    """Return CLOCK_MONOTONIC and CLOCK_MONOTONIC_RAW of one moment in ns; None where one is missing."""
    if not hasattr(time, "CLOCK_MONOTONIC_RAW"):
        return None
    readings = []
    for _ in range(READINGS):
        before_ns = time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)
        monotonic_ns = time.monotonic_ns()
        after_ns = time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)
        readings.append((after_ns - before_ns, monotonic_ns, (before_ns + after_ns) // 2))
    _, monotonic_ns, raw_ns = min(readings)
    return monotonic_ns, raw_ns


class HostRate:
    """Measures by how much this host is slewing its clock."""

    def __init__(
        self,
        read: Callable[[], tuple[int, int] | None] = read_clocks,
        steady_ppm: Callable[[], float | None] = steady_correction_ppm,
    ) -> None:
        """`read` and `steady_ppm` are this host's, but for tests."""
        self._read, self._steady_ppm = read, steady_ppm
        self._last: tuple[int, int] | None = None
        self._slewing_ppm: float | None = None
        self._due_ns: int | None = None

    def slewing_ppm(self, now_ns: int) -> float | None:
        """Return how much faster than usual the host makes its clock run; None where that is not known.

        0 where it does not, or by less than SLEWED_PPM. It is measured anew each EVERY_NS; call it as often
        as you like. `now_ns` is of any clock that does not jump.
        """
        if self._due_ns is None or now_ns >= self._due_ns:
            self._due_ns = now_ns + EVERY_NS
            self._slewing_ppm = self._measure()
        return self._slewing_ppm

    def _measure(self) -> float | None:
        before, now, steady_ppm = self._last, self._read(), self._steady_ppm()
        self._last = now
        if now is None or before is None or steady_ppm is None or now[1] - before[1] < EVERY_NS // 2:
            return None
        usual_ppm = min(max(steady_ppm, -STEADY_PPM), STEADY_PPM)
        slewing_ppm = ((now[0] - before[0]) / (now[1] - before[1]) - 1.0) * 1e6 - usual_ppm
        return slewing_ppm if abs(slewing_ppm) >= SLEWED_PPM else 0.0
