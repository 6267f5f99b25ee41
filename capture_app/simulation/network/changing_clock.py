"""A clock whose rate is changed from outside: slewed by a daemon for a while, or drifting as it warms up."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class RateSpell:
    """Another rate for a while: so much skew (dimensionless) more between two true times in ns."""

    from_true_ns: int
    until_true_ns: int
    skew: float


@dataclass(frozen=True, slots=True)
class ChangingClock:
    """A clock that shows true + offset + skew * elapsed + its spells + drift * elapsed squared / 2.

    Elapsed is the true time since `epoch_true_ns`; `skew` is dimensionless, `drift_ppm_per_s` begins there.
    """

    offset_ns: int
    skew: float
    epoch_true_ns: int
    spells: tuple[RateSpell, ...] = ()
    drift_ppm_per_s: float = 0.0

    def local_from_true(self, true_ns: int) -> int:
        """Reading of this clock in ns at a true time in ns."""
        elapsed = float(true_ns - self.epoch_true_ns)
        gained = self.skew * elapsed + self.drift_ppm_per_s * 1e-15 * max(0.0, elapsed) ** 2 / 2.0
        for spell in self.spells:
            gained += spell.skew * max(0, min(true_ns, spell.until_true_ns) - spell.from_true_ns)
        return true_ns + self.offset_ns + round(gained)
