"""When a lamp was switched, by a camera's rows: each tells how much of its exposure was lit.

The rows that were exposing as it happened are lit in part: a ramp as long as the exposure (and as the lamp
takes), bent by the camera's tone curve. On rising and falling edges it is bent to opposite sides.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.time_offsets.blink_edges import BlinkEdge

WIDTHS_MS = tuple(np.geomspace(0.4, 60.0, 28))
BENDS = (0.55, 0.8, 1.1)
"""Exponents of the tone curve between dark and lit."""
MOST_FITTED = 6
"""Edges by which the ramp is found: more tell hardly more."""
FITTED_ROWS = 100
COVERED = 0.5
"""So much of its ramp must lie on rows that were read."""
LEAST_ROWS = 6
MISFIT = 0.12
STEPS = 61
RAMP_ERROR = 0.015
"""What a tone curve of another form, or light that flickers, moves an edge by, as a share of its ramp."""
SHARED_ROWS = 8
"""Rows that share their errors: those of a compressed picture's blocks."""


@dataclass(frozen=True)
class RowTimes:
    """The middles of the exposures of a camera's rows: of each instant's first row, and of a row more, ms."""

    start_ms: dict[int, float]
    row_ms: float

    def of(self, edge: BlinkEdge) -> Array:
        """(images, rows)."""
        starts = np.array([self.start_ms[k] for k in edge.images])
        return np.asarray(starts[:, None] + self.row_ms * np.arange(edge.lit.shape[1]))


@dataclass(frozen=True)
class Ramp:
    """How long rows show an edge, ms, and the exponent of how that looks."""

    width_ms: float
    bend: float


@dataclass(frozen=True)
class EdgeTime:
    """When the middle of the exposure of a row was at the edge, ms, and that row; None where none tells."""

    at_ms: float
    row: float
    sd_ms: float


def rough_time(edge: BlinkEdge, times: Array) -> float | None:
    """Between which rows (their times of the edge's shape) most are dark before, and lit after."""
    known = np.isfinite(edge.lit)
    if known.sum() < LEAST_ROWS:
        return None
    order = np.argsort(times[known])
    lit = np.clip(edge.lit[known][order], 0, 1)
    lit = lit if edge.rising else 1 - lit
    at = times[known][order]
    before = np.concatenate([[0], np.cumsum(lit**2)])
    after = np.concatenate([np.cumsum(((1 - lit) ** 2)[::-1])[::-1], [0]])
    best = int((before + after).argmin())
    return float((at[max(0, best - 1)] + at[min(best, len(at) - 1)]) / 2)


def fit_ramp(edges: Sequence[BlinkEdge], rows: RowTimes) -> Ramp | None:
    """The ramp that fits the clearest edges best; None where no edge shows enough rows."""
    chosen = [edge for edge in edges if rough_time(edge, rows.of(edge)) is not None]
    chosen = [chosen[int(k)] for k in np.linspace(0, len(chosen) - 1, min(MOST_FITTED, len(chosen)))]
    if not chosen:
        return None
    thinned = []
    for edge in chosen:
        thin = np.s_[:, :: max(1, edge.lit.shape[1] // FITTED_ROWS)]
        times = rows.of(edge)
        near = rough_time(edge, times)
        thinned.append((_Samples.of(edge, times, thin), near))

    def misfit(width: float, bend: float) -> float:
        return sum(one.place(near, width, width, bend)[1] for one, near in thinned if near is not None)

    best = min((misfit(width, bend), width, bend) for width in WIDTHS_MS for bend in BENDS)
    for finer in (0.1, 0.05, 0.025):
        _, width, bend = best
        near_by = [(width * (1 + a * finer), bend + b * finer) for a in (-1, 0, 1) for b in (-2, 0, 2)]
        best = min(best, min((misfit(w, b), w, b) for w, b in near_by))
    return Ramp(best[1], best[2])


def find_edge_time(edge: BlinkEdge, rows: RowTimes, ramp: Ramp) -> EdgeTime | None:
    """When the edge was; None where too little of its ramp lies on rows that were read."""
    times = rows.of(edge)
    near = rough_time(edge, times)
    if near is None:
        return None
    samples = _Samples.of(edge, times)
    reach = ramp.width_ms
    at = near
    for _ in range(3):
        at, _ = samples.place(at, reach, ramp.width_ms, ramp.bend)
        reach /= STEPS / 6
    known = np.isfinite(edge.lit)
    part = (times - at) / ramp.width_ms + 0.5
    inside = known & (part > 0) & (part < 1)
    covered = np.unique(np.floor(part[inside] * 20)).size / 20
    if inside.sum() < LEAST_ROWS or covered < COVERED:
        return None
    miss = (_shape(part, ramp.bend, edge.rising) - edge.lit)[inside]
    misfit = float(np.sqrt(np.mean(np.clip(miss, -0.4, 0.4) ** 2)))
    if misfit > MISFIT:
        return None
    # How much a shift changes what rows show, against their errors; those beside each other share theirs.
    told = np.sqrt(np.sum((1 / ramp.width_ms / np.maximum(edge.sd[inside], misfit)) ** 2) / SHARED_ROWS)
    weights = np.where(inside, 1 - np.abs(2 * part - 1), 0)
    row = float((weights * np.arange(edge.lit.shape[1])).sum() / weights.sum())
    return EdgeTime(at, row, float(np.hypot(1 / told, RAMP_ERROR * ramp.width_ms)))


@dataclass(frozen=True)
class _Samples:
    """Rows that show an edge: times, shares and errors (n,)."""

    rising: bool
    times: Array
    lit: Array
    sd: Array

    @classmethod
    def of(cls, edge: BlinkEdge, times: Array, part: Any = np.s_[:]) -> Self:
        known = np.isfinite(edge.lit[part])
        return cls(edge.rising, times[part][known], edge.lit[part][known], edge.sd[part][known])

    def place(self, near: float, reach: float, width: float, bend: float) -> tuple[float, float]:
        """The time within the reach of another at which the ramp fits best, and how badly it does."""
        places = near + np.linspace(-1, 1, STEPS) * reach
        parts = (self.times[None] - places[:, None]) / width + 0.5
        misses = _shape(parts, bend, self.rising) - self.lit[None]
        costs = np.log1p((misses / (3 * self.sd[None])) ** 2).sum(1)
        k = int(costs.argmin())
        place = float(places[k])
        if 0 < k < STEPS - 1:
            a, b, c = costs[k - 1], costs[k], costs[k + 1]
            if a + c > 2 * b:
                place += float(0.5 * (a - c) / (a + c - 2 * b) * (places[1] - places[0]))
        return place, float(costs[k])


def _shape(part: Array, bend: float, rising: bool) -> Array:
    """How lit rows are that had a part of the ramp behind them."""
    past = np.clip(part, 0, 1)
    return np.asarray(past**bend if rising else (1 - past) ** bend)
