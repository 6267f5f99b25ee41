"""Clocks of nodes: the host's own, or a simulated one with hours of offset and a small skew.

True time (`true_ns`) is the host's clock (`host_clock`), which all processes of one machine share, so that
the error of an estimate between simulated nodes is known.
"""

import random
import sys
from dataclasses import dataclass
from typing import Protocol

from msgspec import Struct

from capture_app.common import host_clock
from capture_app.common.bounds import TimeNs
from capture_app.common.errors import BadInputError

MAX_SKEW_PPM = 1000.0
SEEDED_SKEW_PPM = 50.0
_UNIT = 10**12
_HINT = "use host, sim, or sim:offset_s=7200,skew_ppm=12.5"


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
    """The host's clock, which goes on while the machine sleeps: a leader that slept has the time of its rig.

    Only Windows' clock does so by itself. The length of a sleep is known to a second or better.
    """

    def local_from_true(self, true_ns: int) -> int:
        """Return the reading at a true time since the machine's last sleep, in ns."""
        return true_ns + (0 if sys.platform == "win32" else host_clock.slept_ns())

    def true_from_local(self, local_ns: int) -> int:
        """Return the true time of a reading since the machine's last sleep, in ns."""
        return local_ns - self.local_from_true(0)

    def now_ns(self) -> int:
        """Return the host's clock now, in ns."""
        # The clock is read last: each microsecond until a datagram leaves would be an error of time.
        return self.local_from_true(0) + host_clock.host_ns()


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
        return self.local_from_true(host_clock.host_ns())

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
