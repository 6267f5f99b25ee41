"""The scores of a condition: the median over the instants, with bootstrap intervals over them.

Every instant counts the same, however much moves in it. All conditions use the same bootstrap draws, and stay
paired.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from msgspec import Struct

from reconstruction.common.geometry import Array
from reconstruction.scores.study_result import Interval
from reconstruction.scores.truth import TOLERANCES, right_depth

F_SCORE = "f_score"
MAX_DIFFERENCES = 20000
MIN_COUNT = 30
"""A share of fewer than this is no measurement of its instant."""
MIN_FOR_INTERVAL = 3
"""With fewer instants that have a value there is no interval."""
RESAMPLES = 500
LEVEL_PERCENT = 95.0

Form = TypeVar("Form", bound=Struct)


@dataclass
class Measurements:
    """What was measured at one instant, by measure.

    `shares`: (how many, of how many); `medians` and `means`: values (n,) of which the median or the mean is
    the instant's.
    """

    shares: dict[str, tuple[int, int]] = field(default_factory=dict)
    medians: dict[str, Array] = field(default_factory=dict)
    means: dict[str, Array] = field(default_factory=dict)

    def update(self, other: "Measurements", prefix: str = "") -> None:
        """Take over another's measurements, their names with a prefix, such as `mover_`."""
        self.shares.update({prefix + name: share for name, share in other.shares.items()})
        self.medians.update({prefix + name: values for name, values in other.medians.items()})
        self.means.update({prefix + name: values for name, values in other.means.items()})

    def value(self, measure: str) -> float:
        """The instant's value of a measure; NaN where there is nothing to measure.

        `*f_score` is the harmonic mean of `*precision` and `*recall`.
        """
        if measure.endswith(F_SCORE):
            prefix = measure.removesuffix(F_SCORE)
            precision, recall = self.value(f"{prefix}precision"), self.value(f"{prefix}recall")
            return _harmonic_mean(0.0 if np.isnan(precision) else precision, recall)
        if measure in self.shares:
            part, whole = self.shares[measure]
            return part / whole if whole >= MIN_COUNT else np.nan
        if measure in self.means:
            return float(np.mean(self.means[measure])) if len(self.means[measure]) else np.nan
        values = self.medians.get(measure, np.zeros(0))
        return float(np.median(values)) if len(values) else np.nan


def measure_depth(depth: Array, difference: Array, mask: Array, truth: Array | None) -> Measurements:
    """Measure a mask's (bool) pixels: coverage, photometric_error difference and shares of right depths.

    Depth has 0 where there is none, grey-level differences and true depth (same unit) NaN.
    """
    seen = difference[mask & np.isfinite(difference)]
    found = Measurements({"coverage": (int((depth[mask] > 0).sum()), int(mask.sum()))})
    found.medians["photometric_error"] = seen[:: max(1, len(seen) // MAX_DIFFERENCES)]
    if truth is not None:
        known = mask & np.isfinite(truth)
        for name, tolerance in TOLERANCES.items():
            right = right_depth(depth[known], truth[known], tolerance)
            found.shares[name] = int(right.sum()), int(known.sum())
    return found


class Tally:
    """Measurements of one condition, instant by instant.

    A measure is named as the field of the scores that it becomes.
    """

    def __init__(self, instants: Iterable[Measurements] = ()) -> None:
        self._instants = list(instants)

    def add(self, instant: Measurements) -> None:
        """Add one instant."""
        self._instants.append(instant)

    @property
    def instants(self) -> int:
        """How many instants were added."""
        return len(self._instants)

    def value(self, measure: str) -> float | None:
        """The median over the instants; None where there is nothing to measure in any."""
        values = self._values(measure)
        known = values[np.isfinite(values)]
        return float(np.median(known)) if len(known) else None

    def samples(self, measure: str) -> Array:
        """The measure of every bootstrap draw of the instants; draws of two tallies belong together."""
        values = self._values(measure)
        if np.isfinite(values).sum() < MIN_FOR_INTERVAL:
            return np.zeros(0)
        drawn = values[_draw_instants(len(values))]
        known = np.isfinite(drawn).any(1)
        medians = np.full(RESAMPLES, np.nan)
        medians[known] = np.nanmedian(drawn[known], axis=1)
        return medians

    def intervals(self, measures: Iterable[str]) -> dict[str, Interval]:
        """Measures with their intervals over the instants, where there are enough."""
        known = {name: value for name in measures if (value := self.value(name)) is not None}
        found = {name: _bootstrap_interval(value, self.samples(name)) for name, value in known.items()}
        return {name: one for name, one in found.items() if one is not None}

    def scores(self, form: type[Form]) -> Form:
        """All measures that this form of scores has room for, with their intervals."""
        names = measures_of(form)
        values = {name: self.value(name) for name in names}
        return form(**values, intervals=self.intervals(names), instants=self.instants)

    def _values(self, measure: str) -> Array:
        return np.array([one.value(measure) for one in self._instants])


def measures_of(form: type[Struct]) -> tuple[str, ...]:
    """The measures that a form of scores has room for."""
    return tuple(name for name in form.__struct_fields__ if name not in ("intervals", "instants"))


def differences(synced: Tally, other: Tally, form: type[Struct]) -> dict[str, Interval]:
    """Other minus synced for every measure of a form, paired by instant, with intervals."""
    found = {}
    for name in measures_of(form):
        before, after = synced.value(name), other.value(name)
        if before is None or after is None or synced.instants != other.instants:
            continue
        samples = synced.samples(name), other.samples(name)
        if not all(map(len, samples)):
            continue
        one = _bootstrap_interval(after - before, samples[1] - samples[0])
        if one is not None:
            found[name] = one
    return found


def _harmonic_mean(precision: float, recall: float) -> float:
    return 2 * precision * recall / max(precision + recall, 1e-12)


def _draw_instants(instants: int) -> Array:
    """Instants drawn with replacement (RESAMPLES, instants); the same number gives the same draws."""
    return np.random.default_rng(0).integers(0, instants, (RESAMPLES, instants))


def _bootstrap_interval(value: float | None, samples: Array) -> Interval | None:
    """The middle 95 % of the draws around a value; None where there is no value or too few instants."""
    known = samples[np.isfinite(samples)]
    if value is None or not len(known):
        return None
    rest = (100 - LEVEL_PERCENT) / 2
    low, high = np.percentile(known, [rest, 100 - rest])
    return Interval(value=value, low=float(min(low, value)), high=float(max(high, value)))
