"""The host's clock: the one of this machine that nothing slews, and its readings at times of CLOCK_MONOTONIC.

An NTP daemon that corrects the time makes CLOCK_MONOTONIC run up to a tenth faster or slower for a while.
CLOCK_MONOTONIC_RAW of Linux is the same hardware's count without corrections (clock_gettime(2)). Drivers and
the kernel stamp frames and messages in CLOCK_MONOTONIC, or in clocks that run like it.
"""

import sys
import time
from bisect import bisect_left
from collections.abc import Callable

from capture_app.common import system

TRIES = 3
"""Pairs of readings of which the quickest counts: an interruption between the two rarely hits all."""
MAX_PAIRS = 1024
"""At one for each frame and message they reach back for seconds, farther than a driver delivers frames."""
APART_NS = 1_000_000
"""Minimum time between two pairs that are kept, but for the newest: 500 ppm are half a microsecond in it."""


MIN_SLEEP_NS = 100_000_000
"""Shortest sleep of a machine that counts: far above the resolution of Windows' clocks."""
RAW_CLOCK: int | None = getattr(time, "CLOCK_MONOTONIC_RAW", None) if sys.platform == "linux" else None
"""The clock that nothing slews; None where the system has none."""


def host_ns() -> int:
    """Return the host's clock now, in ns: CLOCK_MONOTONIC_RAW on Linux, CLOCK_MONOTONIC elsewhere."""
    if sys.platform != "win32" and RAW_CLOCK is not None:
        return time.clock_gettime_ns(RAW_CLOCK)
    return system.monotonic_ns()


_asleep_ns = [max(system.asleep_ns() for _ in range(TRIES))]
"""Times that the machine had slept when this process began, and after each sleep since then."""


def slept_ns() -> int:
    """Return for how long the machine has slept since this process began, in ns; it changes at a sleep."""
    if (asleep_ns := system.asleep_ns()) > _asleep_ns[-1] + MIN_SLEEP_NS:
        _asleep_ns.append(asleep_ns)
    return _asleep_ns[-1] - _asleep_ns[0]


class HostReadings:
    """Pairs of readings of CLOCK_MONOTONIC and the host's clock, between which times are interpolated."""

    def __init__(self, read: Callable[[], tuple[int, int]]) -> None:
        """`read` returns one pair, in ns."""
        self._read = read
        self._monotonic_ns: list[int] = []
        self._host_ns: list[int] = []

    def host_from_monotonic(self, monotonic_ns: int) -> int:
        """Return the host's clock at a recent time of CLOCK_MONOTONIC, both in ns.

        It is late by the time that a reading takes. A slew that begins or ends between two calls shifts the
        times between them by at most a quarter of what it amounts to in between. Before the first call and
        after this one, the clocks count as parallel.
        """
        monotonic, host = self._monotonic_ns, self._host_ns
        now_monotonic_ns, now_host_ns = self._read()
        if len(monotonic) > 1 and now_monotonic_ns < monotonic[-2] + APART_NS:
            del monotonic[-1], host[-1]
        monotonic.append(now_monotonic_ns)
        host.append(now_host_ns)
        if len(monotonic) > MAX_PAIRS:
            del monotonic[: MAX_PAIRS // 2], host[: MAX_PAIRS // 2]
        after = bisect_left(monotonic, monotonic_ns)
        if after in (0, len(monotonic)):
            nearest = min(after, len(monotonic) - 1)
            return monotonic_ns + host[nearest] - monotonic[nearest]
        since_ns, span_ns = monotonic_ns - monotonic[after - 1], monotonic[after] - monotonic[after - 1]
        return host[after - 1] + (host[after] - host[after - 1]) * since_ns // span_ns


def read_pair() -> tuple[int, int]:
    """Return CLOCK_MONOTONIC and the host's clock at one moment, in ns; the latter is late, never early."""
    pairs = []
    for _ in range(TRIES):
        begun_ns = host_ns()
        monotonic_ns = system.monotonic_ns()
        ended_ns = host_ns()
        pairs.append((ended_ns - begun_ns, monotonic_ns, ended_ns))
    return min(pairs)[1:]


_readings = HostReadings(read_pair)


def host_from_monotonic(monotonic_ns: int) -> int:
    """Return the host's clock at a recent time of CLOCK_MONOTONIC, both in ns, to about a microsecond.

    To be called on the event loop only.
    """
    return monotonic_ns if RAW_CLOCK is None else _readings.host_from_monotonic(monotonic_ns)
