"""A clock whose rate follows a temperature: slow waves around a constant skew."""

import random
from dataclasses import dataclass
from math import pi, sin

_S = 1e9
Wave = tuple[float, float, float]
"""Amplitude (dimensionless), angular frequency in radians a ns, phase in radians."""


@dataclass(frozen=True, slots=True)
class WanderingClock:
    """A clock that shows true + offset + skew * true + the integral of its waves; `skew` is dimensionless."""

    offset_ns: int
    skew: float
    waves: tuple[Wave, ...]

    def local_from_true(self, true_ns: int) -> int:
        """Reading of this clock in ns at a true time in ns."""
        return true_ns + self.offset_ns + round(self._gained_ns(true_ns))

    def true_from_local(self, local_ns: int) -> int:
        """True time in ns of a reading in ns, the inverse of `local_from_true` to 20 ns in hours."""
        elapsed_ns = local_ns - self.offset_ns
        true_ns = elapsed_ns - self._gained_ns(elapsed_ns)
        return round(elapsed_ns - self._gained_ns(true_ns))

    def _gained_ns(self, true_ns: float) -> float:
        gained = self.skew * true_ns
        for amplitude, rate, phase in self.waves:
            gained += amplitude / rate * (sin(rate * true_ns + phase) - sin(phase))
        return gained


def wandering_clock(
    rng: random.Random, *, skew_ppm: float = 20.0, wander_ppm: float = 0.3, days: float = 1.0
) -> WanderingClock:
    """Draw a clock: offset up to `days`, skew of one sigma, waves of 15 to 60 minutes and of 5 to 15.

    The long wave has an amplitude of up to `wander_ppm`, as a room's heating gives; the short one a sixth.
    """
    waves = []
    for share, shortest_s, longest_s in ((1.0, 900.0, 3600.0), (1.0 / 6.0, 300.0, 900.0)):
        amplitude = rng.uniform(0.0, wander_ppm) * share * 1e-6
        rate = 2.0 * pi / (rng.uniform(shortest_s, longest_s) * _S)
        waves.append((amplitude, rate, rng.uniform(0.0, 2.0 * pi)))
    offset_ns = round(rng.uniform(-days, days) * 86400 * _S)
    return WanderingClock(offset_ns, rng.gauss(0.0, skew_ppm) * 1e-6, tuple(waves))
