"""What a condition is worth, counted instant by instant, with intervals over the instants."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.scores.bootstrap import bootstrap_interval, pooled_samples, share_samples
from reconstruction.scores.depth_results import DepthScores
from reconstruction.scores.results import Interval

KINDS = ("mover", "static")
TOLERANCES = {"within_1pct": 0.01, "within_2pct": 0.02, "within_5pct": 0.05}
"""Greatest relative error of a depth that counts as right."""
SHARES = ("coverage", *TOLERANCES, "consistency", "precision", "recall")
AMOUNTS = ("points",)
F_SCORE = "f_score"
MOST_DIFFERENCES = 20000
MOST_DRAWN = 1500
"""Values of an instant that its bootstrap draws are made of."""
FEWEST_FOR_INTERVAL = 3
"""Fewer instants than this say nothing about how instants differ."""

Scores = TypeVar("Scores", bound=DepthScores)


@dataclass
class Count:
    """One kind of pixels of one instant: (how many, of how many), values of which the median counts, and
    amounts of which the mean counts, by measure."""

    shares: dict[str, tuple[int, int]] = field(default_factory=dict)
    values: dict[str, Array] = field(default_factory=dict)
    amounts: dict[str, float] = field(default_factory=dict)


def count_depth(depth: Array, difference: Array, mask: Array, truth: Array | None) -> Count:
    """Count a mask's (bool) pixels.

    Depth has 0 where there is none, grey-level differences and true depth (same unit) NaN.
    """
    seen = difference[mask & np.isfinite(difference)]
    count = Count({"coverage": (int((depth[mask] > 0).sum()), int(mask.sum()))})
    count.values["photometric"] = seen[:: max(1, len(seen) // MOST_DIFFERENCES)]
    if truth is not None:
        known = mask & np.isfinite(truth)
        error = np.abs(depth[known] - truth[known])
        for name, tolerance in TOLERANCES.items():
            count.shares[name] = int(np.sum(error < tolerance * truth[known])), int(known.sum())
    return count


class Tally:
    """Scores of one condition, added up over instants; every pixel counts the same."""

    def __init__(self) -> None:
        self._counts: dict[str, list[Count]] = {kind: [] for kind in KINDS}

    def add(self, moving: Count, static: Count) -> None:
        """Count one instant."""
        for kind, count in zip(KINDS, (moving, static), strict=True):
            self._counts[kind].append(count)

    @property
    def instants(self) -> int:
        """How many instants were added."""
        return len(self._counts["mover"])

    def value(self, kind: str, measure: str) -> float | None:
        """A measure over everything counted; None where there is nothing to measure."""
        if measure == F_SCORE:
            recall = self.value(kind, "recall")
            if recall is None:
                return None
            return float(_harmonic(self.value(kind, "precision") or 0.0, recall))
        if measure in SHARES:
            parts, wholes = self._shares(kind, measure)
            return float(parts.sum() / wholes.sum()) if wholes.sum() else None
        known = np.concatenate([np.zeros(0), *self._values(kind, measure)])
        return float(_middle(measure)(known)) if len(known) else None

    def samples(self, kind: str, measure: str) -> Array:
        """The measure of every bootstrap draw of the instants; draws of two tallies belong together."""
        if self.instants < FEWEST_FOR_INTERVAL:
            return np.zeros(0)
        if measure == F_SCORE:
            precision, recall = self.samples(kind, "precision"), self.samples(kind, "recall")
            return np.asarray(_harmonic(np.nan_to_num(precision), recall))
        if measure in SHARES:
            return share_samples(*self._shares(kind, measure))
        thinned = [v[:: max(1, len(v) // MOST_DRAWN)] for v in self._values(kind, measure)]
        return pooled_samples(thinned, _middle(measure))

    def interval(self, kind: str, measure: str) -> Interval | None:
        """The measure with its interval over the instants."""
        return bootstrap_interval(self.value(kind, measure), self.samples(kind, measure))

    def scores(self, form: type[Scores], *, intervals: bool = False) -> Scores:
        """All that this form of scores has room for, over everything counted."""
        values = {name: self.value(*pair) for name, pair in measures(form).items()}
        known = {}
        if intervals:
            found = {name: self.interval(*pair) for name, pair in measures(form).items()}
            known = {name: one for name, one in found.items() if one is not None}
        return form(**values, intervals=known, instants=self.instants)

    def _shares(self, kind: str, measure: str) -> tuple[Array, Array]:
        pairs = [count.shares.get(measure, (0, 0)) for count in self._counts[kind]]
        return np.array([part for part, _ in pairs]), np.array([whole for _, whole in pairs])

    def _values(self, kind: str, measure: str) -> list[Array]:
        if measure in AMOUNTS:
            amounts = [count.amounts.get(measure) for count in self._counts[kind]]
            return [np.zeros(0) if amount is None else np.array([float(amount)]) for amount in amounts]
        return [count.values.get(measure, np.zeros(0)) for count in self._counts[kind]]


def measures(form: type[DepthScores]) -> Mapping[str, tuple[str, str]]:
    """A form's measures by field: the kind of pixels, and what is measured on them."""
    parted = {name: name.partition("_") for name in form.__struct_fields__}
    return {name: (kind, measure) for name, (kind, _, measure) in parted.items() if kind in KINDS}


def differences(synced: Tally, other: Tally, form: type[DepthScores]) -> dict[str, Interval]:
    """Other minus synced for every measure of a form, paired by instant, with intervals."""
    found = {}
    for name, pair in measures(form).items():
        before, after = synced.value(*pair), other.value(*pair)
        if before is None or after is None or synced.instants != other.instants:
            continue
        one = bootstrap_interval(after - before, other.samples(*pair) - synced.samples(*pair))
        if one is not None:
            found[name] = one
    return found


def _middle(measure: str) -> Callable[[Array], float]:
    return (lambda v: float(np.mean(v))) if measure in AMOUNTS else (lambda v: float(np.median(v)))


def _harmonic(precision: Array | float, recall: Array | float) -> Array:
    total = np.asarray(precision) + recall
    return np.asarray(2 * np.asarray(precision) * recall / np.maximum(total, 1e-12))
