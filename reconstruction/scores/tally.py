"""The scores of a condition: measurements of every instant, pooled, with bootstrap intervals over them.

All conditions use the same bootstrap draws, and stay paired.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from msgspec import Struct

from reconstruction.common.geometry import Array
from reconstruction.scores.depth_truth import TOLERANCES, right_depth
from reconstruction.scores.results import Interval

F_SCORE = "f_score"
MAX_DIFFERENCES = 20000
MAX_DRAWN_VALUES = 1500
"""Values of an instant that its bootstrap draws are made of."""
MIN_FOR_INTERVAL = 3
"""With fewer instants there are no intervals."""
RESAMPLES = 500
LEVEL_PERCENT = 95.0

Form = TypeVar("Form", bound=Struct)


@dataclass
class Measurements:
    """What was measured at one instant, by measure.

    `shares`: (how many, of how many), pooled over the instants; `medians` and `means`: values (n,) of which
    the median or the mean over all instants counts.
    """

    shares: dict[str, tuple[int, int]] = field(default_factory=dict)
    medians: dict[str, Array] = field(default_factory=dict)
    means: dict[str, Array] = field(default_factory=dict)

    def minus(self, other: "Measurements") -> "Measurements":
        """The difference in every mean that both have."""
        both = self.means.keys() & other.means.keys()
        return Measurements(means={name: self.means[name] - other.means[name] for name in both})

    def update(self, other: "Measurements", prefix: str = "") -> None:
        """Take over another's measurements, their names with a prefix, such as `mover_`."""
        self.shares.update({prefix + name: share for name, share in other.shares.items()})
        self.medians.update({prefix + name: values for name, values in other.medians.items()})
        self.means.update({prefix + name: values for name, values in other.means.items()})


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
    """Measurements of one condition, added up over instants; every pixel counts the same.

    A measure is named as the field of the scores that it becomes. `*f_score` is the harmonic mean of
    `*precision` and `*recall`.
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
        """A measure over all instants; None where there is nothing to measure."""
        if measure.endswith(F_SCORE):
            precision, recall = (self.value(name) for name in _precision_and_recall(measure))
            return None if recall is None else float(_harmonic_mean(precision or 0.0, recall))
        if self._is_share(measure):
            parts, wholes = self._shares(measure)
            return float(parts.sum() / wholes.sum()) if wholes.sum() else None
        known = np.concatenate([np.zeros(0), *self._values(measure)])
        return self._middle(measure, known) if len(known) else None

    def samples(self, measure: str) -> Array:
        """The measure of every bootstrap draw of the instants; draws of two tallies belong together."""
        if self.instants < MIN_FOR_INTERVAL:
            return np.zeros(0)
        if measure.endswith(F_SCORE):
            drawn, recalls = (self.samples(name) for name in _precision_and_recall(measure))
            return np.asarray(_harmonic_mean(np.nan_to_num(drawn), recalls))
        if self._is_share(measure):
            return _share_samples(*self._shares(measure))
        thinned = [v[:: max(1, len(v) // MAX_DRAWN_VALUES)] for v in self._values(measure)]
        return _pooled_samples(thinned, lambda values: self._middle(measure, values))

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

    def _is_share(self, measure: str) -> bool:
        return any(measure in one.shares for one in self._instants)

    def _shares(self, measure: str) -> tuple[Array, Array]:
        pairs = [one.shares.get(measure, (0, 0)) for one in self._instants]
        return np.array([part for part, _ in pairs]), np.array([whole for _, whole in pairs])

    def _values(self, measure: str) -> list[Array]:
        return [one.means.get(measure, one.medians.get(measure, np.zeros(0))) for one in self._instants]

    def _middle(self, measure: str, values: Array) -> float:
        mean = any(measure in one.means for one in self._instants)
        return float(np.mean(values) if mean else np.median(values))


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
        one = _bootstrap_interval(after - before, other.samples(name) - synced.samples(name))
        if one is not None:
            found[name] = one
    return found


def _precision_and_recall(measure: str) -> tuple[str, str]:
    prefix = measure.removesuffix(F_SCORE)
    return prefix + "precision", prefix + "recall"


def _harmonic_mean(precision: Array | float, recall: Array | float) -> Array:
    total = np.asarray(precision) + recall
    return np.asarray(2 * np.asarray(precision) * recall / np.maximum(total, 1e-12))


def _draw_instants(instants: int) -> Array:
    """Instants drawn with replacement (RESAMPLES, instants); the same number gives the same draws."""
    return np.random.default_rng(0).integers(0, instants, (RESAMPLES, instants))


def _share_samples(parts: Array, wholes: Array) -> Array:
    """The pooled share, sum of parts over sum of wholes, of every draw (RESAMPLES,); NaN = nothing there."""
    drawn = _draw_instants(len(parts))
    total = wholes[drawn].sum(1)
    return np.asarray(np.where(total > 0, parts[drawn].sum(1) / np.maximum(total, 1), np.nan))


def _pooled_samples(values: list[Array], estimate: Callable[[Array], float]) -> Array:
    """An estimate over the pooled values (one array for each instant) of every draw (RESAMPLES,)."""
    found = np.full(RESAMPLES, np.nan)
    for i, drawn in enumerate(_draw_instants(len(values))):
        pooled = np.concatenate([values[k] for k in drawn])
        if len(pooled):
            found[i] = estimate(pooled)
    return found


def _bootstrap_interval(value: float | None, samples: Array) -> Interval | None:
    """The middle 95 % of the draws around a value; None where there is no value or only one instant."""
    known = samples[np.isfinite(samples)]
    if value is None or not len(known):
        return None
    rest = (100 - LEVEL_PERCENT) / 2
    low, high = np.percentile(known, [rest, 100 - rest])
    return Interval(value=value, low=float(min(low, value)), high=float(max(high, value)))
