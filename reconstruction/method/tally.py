"""Measures of two conditions: medians over the instants, with bootstrap intervals.

Every instant has the same weight, however much moves in it. Both conditions use the same bootstrap draws.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.method.study_result import Interval, Measure
from reconstruction.method.truth import TOLERANCES, right_depth

CONDITIONS = ("synced", "offset")
"""The conditions: synchronized, and the other one."""
F_SCORE = "f_score"
MIN_COUNT = 30
"""Minimum pixel or point count from which a fraction is measured at an instant."""
MIN_FOR_INTERVAL = 3
"""Minimum number of instants with a value from which an interval is computed."""
RESAMPLES = 500


@dataclass
class Measurements:
    """Measurements at one instant, by measure.

    `shares` holds a count and its total. `medians` and `means` hold values (n,), whose median or mean is the
    instant's value.
    """

    shares: dict[str, tuple[int, int]] = field(default_factory=dict)
    medians: dict[str, Array] = field(default_factory=dict)
    means: dict[str, Array] = field(default_factory=dict)

    def update(self, other: "Measurements", prefix: str = "") -> None:
        """Add another object's measurements, with a prefix such as `mover_` before their names."""
        for kind, pooled in vars(other).items():
            getattr(self, kind).update({prefix + name: values for name, values in pooled.items()})

    @property
    def names(self) -> list[str]:
        """Names of the measures taken; includes `*f_score` if precision and recall were taken."""
        scored = [name.replace("recall", F_SCORE) for name in self.shares if name.endswith("recall")]
        return [*self.shares, *self.medians, *self.means, *scored]

    def value(self, measure: str) -> float:
        """Return the instant's value of a measure; NaN if there is nothing to measure.

        `*f_score` is the harmonic mean of `*precision` and `*recall`.
        """
        if measure.endswith(F_SCORE):
            prefix = measure.removesuffix(F_SCORE)
            precision, recall = self.value(f"{prefix}precision"), self.value(f"{prefix}recall")
            precision = 0.0 if np.isnan(precision) else precision
            return 2 * precision * recall / max(precision + recall, 1e-12)
        if measure in self.shares:
            part, whole = self.shares[measure]
            return part / whole if whole >= MIN_COUNT else np.nan
        found, middle = (self.means, np.mean) if measure in self.means else (self.medians, np.median)
        values = found.get(measure, np.zeros(0))
        return float(middle(values)) if len(values) else np.nan


def measure_depth(depth: Array, difference: Array, mask: Array, truth: Array | None) -> Measurements:
    """Measure a mask's pixels (bool): coverage, photometric_error (`difference`), fractions of right depths.

    Unknown depth is 0; unknown grey-level differences and unknown true depth (same unit) are NaN.
    """
    seen = difference[mask & np.isfinite(difference)]
    measured = Measurements(
        shares={"coverage": (int((depth[mask] > 0).sum()), int(mask.sum()))},
        medians={"photometric_error": seen[:: max(1, len(seen) // 20000)]},
    )
    if truth is not None:
        known = mask & np.isfinite(truth)
        for name, tolerance in TOLERANCES.items():
            right = right_depth(depth[known], truth[known], tolerance)
            measured.shares[name] = int(right.sum()), right.size
    return measured


@dataclass
class Tally:
    """Measurements of both conditions on the same instants, given as rows or added one by one."""

    rows: list[tuple[Mapping[str, Measurements], Mapping[str, float]]] = field(default_factory=list)
    """For each instant the measurements in both conditions, and the facts with which its row begins."""

    def add(self, measured: Mapping[str, Measurements], facts: Mapping[str, float]) -> None:
        """Add an instant's row."""
        self.rows.append((measured, facts))

    @property
    def instants(self) -> int:
        """Number of instants added."""
        return len(self.rows)

    @property
    def names(self) -> list[str]:
        """Names of the measures taken at any instant."""
        return list(
            dict.fromkeys(n for measured, _ in self.rows for side in CONDITIONS for n in measured[side].names)
        )

    @property
    def measures(self) -> tuple[Measure, ...]:
        """Medians over the instants with intervals; measures without a value are left out."""
        return tuple(
            measure for measure in map(self._measure, self.names) if measure.synced or measure.offset
        )

    @property
    def per_instant(self) -> tuple[dict[str, float | int | None], ...]:
        """Facts of every instant, with its value of each measure in both conditions."""
        measures = [(side, name) for side in CONDITIONS for name in self.names]
        rows = (
            {**facts, **{f"{side}_{name}": measured[side].value(name) for side, name in measures}}
            for measured, facts in self.rows
        )
        return tuple({key: None if np.isnan(v) else v for key, v in row.items()} for row in rows)

    def _measure(self, name: str) -> Measure:
        values = [np.array([row[side].value(name) for row, _ in self.rows]) for side in CONDITIONS]
        before, after = (_resampled_medians(side) for side in values)
        synced, offset = _interval(values[0], before), _interval(values[1], after)
        if not (synced and offset and len(before) and len(after)):
            return Measure(name=name, synced=synced, offset=offset)
        change = _interval(np.array([offset.value - synced.value]), after - before)
        return Measure(name=name, synced=synced, offset=offset, difference=change)


def _resampled_medians(values: Array) -> Array:
    """Return the median of every bootstrap draw of the instants; empty with too few.

    Equal numbers of instants get the same draws.
    """
    if np.isfinite(values).sum() < MIN_FOR_INTERVAL:
        return np.zeros(0)
    drawn = values[np.random.default_rng(0).integers(0, len(values), (RESAMPLES, len(values)))]
    known = np.isfinite(drawn).any(1)
    medians = np.full(RESAMPLES, np.nan)
    medians[known] = np.nanmedian(drawn[known], axis=1)
    return medians


def _interval(values: Array, draws: Array) -> Interval | None:
    """Return the median of known values with the middle 95 % of the draws around it; None without values."""
    known, drawn = values[np.isfinite(values)], draws[np.isfinite(draws)]
    if not len(known):
        return None
    value = float(np.median(known))
    if not len(drawn):
        return Interval(value=value)
    low, high = np.percentile(drawn, [2.5, 97.5])
    return Interval(value=value, low=float(min(low, value)), high=float(max(high, value)))
