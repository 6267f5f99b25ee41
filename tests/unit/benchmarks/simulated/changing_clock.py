"""Clocks whose rate changes: slewed for a while, or drifting as they warm up."""

from dataclasses import dataclass

STEPS = 6
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
        for _ in range(STEPS):
            true_ns += local_ns - self.local_from_true(true_ns)
        return true_ns

    def now_ns(self) -> int:
        """Not used: a simulated rig asks for readings at its own times."""
        raise NotImplementedError
