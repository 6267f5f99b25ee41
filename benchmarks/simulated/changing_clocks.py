"""Clocks whose rate changes: with a temperature, for a while, or as they warm up."""

import random
from dataclasses import dataclass, field
from math import cos, pi, sin

_S = 1e9
_CELL_BITS = 30
_HALF_CELL_NS = 1 << (_CELL_BITS - 1)
Wave = tuple[float, float, float]
"""Amplitude (dimensionless), angular frequency in radians per ns, phase in radians."""


@dataclass(slots=True)
class WanderingClock:
    """A clock that shows true + offset + skew * true + the integral of its waves; `skew` is dimensionless.

    Within a second the waves are a parabola to a thousandth of a ns, and are evaluated by it.
    """

    offset_ns: int
    skew: float
    waves: tuple[Wave, ...]
    _cell: int | None = field(default=None, init=False, compare=False)
    _middle_ns: int = field(default=0, init=False, compare=False)
    _gained_ns: float = field(default=0.0, init=False, compare=False)
    _rate: float = field(default=0.0, init=False, compare=False)
    _bend: float = field(default=0.0, init=False, compare=False)

    def local_from_true(self, true_ns: int) -> int:
        """Return the reading of this clock in ns at a true time in ns."""
        return true_ns + self.offset_ns + round(self._gained_at(true_ns))

    def true_from_local(self, local_ns: int) -> int:
        """Return the true time of a reading, both in ns; inverts `local_from_true` to 20 ns in hours."""
        elapsed_ns = local_ns - self.offset_ns
        return round(elapsed_ns - self._gained_at(round(elapsed_ns - self._gained_at(elapsed_ns))))

    def _gained_at(self, true_ns: int) -> float:
        if true_ns >> _CELL_BITS != self._cell:
            self._enter(true_ns >> _CELL_BITS)
        since_ns = true_ns - self._middle_ns
        return self._gained_ns + since_ns * (self._rate + since_ns * self._bend)

    def _enter(self, cell: int) -> None:
        """Compute the parabola of that second."""
        middle_ns = (cell << _CELL_BITS) + _HALF_CELL_NS
        self._cell, self._middle_ns = cell, middle_ns
        self._gained_ns, self._rate, self._bend = self.skew * middle_ns, self.skew, 0.0
        for amplitude, rate, phase in self.waves:
            angle = rate * middle_ns + phase
            self._gained_ns += amplitude / rate * (sin(angle) - sin(phase))
            self._rate += amplitude * cos(angle)
            self._bend -= amplitude * rate * sin(angle) / 2.0


def draw_wandering_clock(rng: random.Random, *, wander_ppm: float = 0.3) -> WanderingClock:
    """Draw a clock: offset up to a day, skew of 20 ppm (1 sigma), waves of 15 to 60 minutes and of 5 to 15.

    The long wave has an amplitude of up to `wander_ppm`, as a room's heating causes; the short one a sixth.
    """
    waves = []
    for share, shortest_s, longest_s in ((1.0, 900.0, 3600.0), (1.0 / 6.0, 300.0, 900.0)):
        amplitude = rng.uniform(0.0, wander_ppm) * share * 1e-6
        rate = 2.0 * pi / (rng.uniform(shortest_s, longest_s) * _S)
        waves.append((amplitude, rate, rng.uniform(0.0, 2.0 * pi)))
    offset_ns = round(rng.uniform(-1.0, 1.0) * 86400 * _S)
    return WanderingClock(offset_ns, rng.gauss(0.0, 20.0) * 1e-6, tuple(waves))


_STEPS = 6
"""Iterations of the inverse: each leaves a fraction of the error equal to the rate, a twelfth at most."""


@dataclass(frozen=True, slots=True)
class RateSpell:
    """A temporary rate change: this additional skew (dimensionless) between two true times in ns."""

    from_true_ns: int
    until_true_ns: int
    skew: float


@dataclass(frozen=True, slots=True)
class ChangingClock:
    """A clock that shows true + offset + skew * elapsed + its spells + drift * elapsed squared / 2.

    Elapsed is the true time since `epoch_true_ns`. `skew` is dimensionless. `drift_ppm_per_s` starts there,
    or at another true time.
    """

    offset_ns: int
    skew: float
    epoch_true_ns: int
    spells: tuple[RateSpell, ...] = ()
    drift_ppm_per_s: float = 0.0
    drift_from_true_ns: int | None = None

    def local_from_true(self, true_ns: int) -> int:
        """Return the reading of this clock in ns at a true time in ns."""
        elapsed = float(true_ns - self.epoch_true_ns)
        begun_ns = self.epoch_true_ns if self.drift_from_true_ns is None else self.drift_from_true_ns
        drifting = max(0.0, float(true_ns - begun_ns))
        gained = self.skew * elapsed + self.drift_ppm_per_s * 1e-15 * drifting**2 / 2.0
        for spell in self.spells:
            gained += spell.skew * max(0, min(true_ns, spell.until_true_ns) - spell.from_true_ns)
        return true_ns + self.offset_ns + round(gained)

    def true_from_local(self, local_ns: int) -> int:
        """Return the true time in ns of a reading in ns, the inverse of `local_from_true` to some ns."""
        true_ns = local_ns - self.offset_ns
        for _ in range(_STEPS):
            true_ns += local_ns - self.local_from_true(true_ns)
        return true_ns

    def now_ns(self) -> int:
        """Not used: a simulated rig asks for readings at its own times."""
        raise NotImplementedError
