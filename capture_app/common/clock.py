"""Clocks of nodes: the host's own, or a simulated one with hours of offset and a small skew.

True time (`true_ns`) is the host's CLOCK_MONOTONIC, which all processes of one machine share, so that the
error of an estimate between simulated nodes is known. Only `now_ns` reads a clock.

CLOCK_MONOTONIC stamps frames and messages. An NTP daemon that corrects the time makes it run faster or slower
for a while. CLOCK_MONOTONIC_RAW is the same hardware clock without corrections, and `adjtimex` reports the
steady frequency correction in force (adjtimex(2), clock_gettime(2)).
"""

import ctypes
import random
import sys
import time
from dataclasses import dataclass
from typing import Protocol

from msgspec import Struct

from capture_app.common.bounds import TimeNs
from capture_app.common.errors import BadInputError

MAX_SKEW_PPM = 1000.0
SEEDED_SKEW_PPM = 50.0
_UNIT = 10**12
_HINT = "use host, sim, or sim:offset_s=7200,skew_ppm=12.5"
EVERY_NS = 4_000_000_000
"""Interval over which two clocks read microseconds apart show their rates to about one ppm."""
SLEWED_PPM = 20.0
"""Minimum rate correction beyond the steady one that is reported."""
STEADY_PPM = 100.0
"""Maximum steady correction of an ordinary crystal; the excess is an ongoing correction of the time."""
TYPICAL_TICK_US = 10_000


class NodeClock(Protocol):
    """Clock of a node, with the map to true time that only a simulation knows."""

    def local_from_true(self, true_ns: int) -> int:
        """Return the reading of this clock in ns at a true time in ns."""

    def true_from_local(self, local_ns: int) -> int:
        """Return the true time in ns of a reading in ns, the inverse of `local_from_true` to 1 ns."""

    def now_ns(self) -> int:
        """Return the reading of this clock now, in ns."""


@dataclass(frozen=True, slots=True)
class HostClock:
    """The host's monotonic clock, unchanged."""

    def local_from_true(self, true_ns: int) -> int:
        """Return `true_ns` itself: this clock is the true time."""
        return true_ns

    def true_from_local(self, local_ns: int) -> int:
        """Return `local_ns` itself: this clock is the true time."""
        return local_ns

    def now_ns(self) -> int:
        """Return CLOCK_MONOTONIC now, in ns."""
        return time.monotonic_ns()


class SimulatedClock(Struct, frozen=True, forbid_unknown_fields=True):
    """Clock that shows true + offset + skew * (true - epoch); skew in parts per million, exact to 1e-6.

    Simulated nodes and sessions record it as the ground truth of their clock.
    """

    offset_ns: TimeNs
    skew_ppm: float = 0.0
    epoch_true_ns: TimeNs = 0

    def __post_init__(self) -> None:
        """Raise BadInputError for an offset or a skew out of range."""
        if not abs(self.skew_ppm) <= MAX_SKEW_PPM:
            raise BadInputError(
                f"a clock skew of {self.skew_ppm:g} ppm is too large", hint=f"at most {MAX_SKEW_PPM:g} ppm"
            )

    def local_from_true(self, true_ns: int) -> int:
        """Return the reading of this clock in ns at a true time in ns."""
        return true_ns + self.offset_ns + _divide((true_ns - self.epoch_true_ns) * self._skew_units, _UNIT)

    def true_from_local(self, local_ns: int) -> int:
        """Return the true time in ns of a reading in ns, the inverse of `local_from_true` to 1 ns."""
        elapsed_local_ns = local_ns - self.offset_ns - self.epoch_true_ns
        return self.epoch_true_ns + _divide(elapsed_local_ns * _UNIT, _UNIT + self._skew_units)

    def now_ns(self) -> int:
        """Return the reading of this clock now, in ns."""
        return self.local_from_true(time.monotonic_ns())

    @property
    def _skew_units(self) -> int:
        return round(self.skew_ppm * (_UNIT // 10**6))


def seeded_clock(node: str) -> SimulatedClock:
    """Return the clock of a node name: hours of offset, up to 50 ppm of skew, the same in every run."""
    rng = random.Random(f"clock of {node}")
    return SimulatedClock(
        offset_ns=round(rng.uniform(3600.0, 36000.0) * 1e9),
        skew_ppm=rng.uniform(-SEEDED_SKEW_PPM, SEEDED_SKEW_PPM),
    )


def parse_clock(text: str, *, node: str) -> NodeClock:
    """Parse the option `--clock`: `host`, `sim` (seeded by the node's name) or `sim:offset_s=…,skew_ppm=…`.

    Omitted values are zero. Raises BadInputError.
    """
    kind, colon, rest = text.strip().partition(":")
    if kind == "host" and not colon:
        return HostClock()
    if kind != "sim":
        raise BadInputError(f"unknown clock {text!r}", hint=_HINT)
    if not colon:
        return seeded_clock(node)
    values = {"offset_s": 0.0, "skew_ppm": 0.0}
    for part in rest.split(","):
        key, equals, value = (piece.strip() for piece in part.partition("="))
        if key not in values or not equals:
            raise BadInputError(f"unknown clock option {part!r} in {text!r}", hint=_HINT)
        try:
            values[key] = float(value)
        except ValueError:
            raise BadInputError(f"{key} of clock {text!r} is not a number: {value!r}", hint=_HINT) from None
    if not abs(values["offset_s"]) <= 10.0 * 365 * 86400:
        raise BadInputError(
            f"a clock offset of {values['offset_s']:g} s is too large", hint="at most ten years"
        )
    return SimulatedClock(round(values["offset_s"] * 1e9), values["skew_ppm"])


def _divide(numerator: int, denominator: int) -> int:
    """Return the quotient rounded to the nearest integer; floats would lose nanoseconds after hours."""
    return (2 * numerator + denominator) // (2 * denominator)


class _Timex(ctypes.Structure):
    """First fields of `struct timex`, and space for the rest."""

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


class HostRate:
    """Measurement of the rate by which this host is slewing its clock."""

    def __init__(self) -> None:
        self._last: tuple[int, int] | None = None
        self._slewing_ppm: float | None = None
        self._due_ns: int | None = None

    def slewing_ppm(self, now_ns: int) -> float | None:
        """Return the rate by which the host is slewing its clock, in ppm; None if unknown.

        0 if it is below SLEWED_PPM. It is measured once per EVERY_NS; calls may be more frequent. `now_ns`
        may be of any clock that does not jump.
        """
        if self._due_ns is None or now_ns >= self._due_ns:
            self._due_ns = now_ns + EVERY_NS
            self._slewing_ppm = self._measure()
        return self._slewing_ppm

    def _measure(self) -> float | None:
        before, now, steady_ppm = self._last, self.read_clocks(), self.steady_correction_ppm()
        self._last = now
        if now is None or before is None or steady_ppm is None or now[1] - before[1] < EVERY_NS // 2:
            return None
        steady_ppm = min(max(steady_ppm, -STEADY_PPM), STEADY_PPM)
        slewing_ppm = ((now[0] - before[0]) / (now[1] - before[1]) - 1.0) * 1e6 - steady_ppm
        return slewing_ppm if abs(slewing_ppm) >= SLEWED_PPM else 0.0

    @staticmethod
    def steady_correction_ppm() -> float | None:
        """Return the kernel's steady frequency correction in ppm; None if the platform does not report it."""
        if not sys.platform.startswith("linux"):
            return None
        kernel = _Timex()
        try:
            if ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.byref(kernel)) < 0:
                return None
        except (OSError, AttributeError):
            return None
        return (int(kernel.tick) / TYPICAL_TICK_US - 1.0) * 1e6 + int(kernel.freq) / 65536.0

    @staticmethod
    def read_clocks() -> tuple[int, int] | None:
        """Return CLOCK_MONOTONIC and CLOCK_MONOTONIC_RAW at one moment in ns; None if one is missing."""
        if not hasattr(time, "CLOCK_MONOTONIC_RAW"):
            return None
        readings = []
        for _ in range(5):
            before_ns = time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)
            monotonic_ns = time.monotonic_ns()
            after_ns = time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)
            readings.append((after_ns - before_ns, monotonic_ns, (before_ns + after_ns) // 2))
        return min(readings)[1:]
