"""A dose curve put together from comparisons of offset pictures with those of one instant."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from reconstruction.scores.dose_result import DoseInstant, DosePoint
from reconstruction.scores.results import StereoComparison
from reconstruction.scores.tally import MIN_COUNT

CLEAR_PEAK = 0.15
"""A point of an instant's curve that is higher than the median of the others by this much is its peak."""
LOSS = 0.1
"""The share of the synchronized value whose loss an offset may cause and still be tolerable."""


class DoseCurve:
    """What was found at each offset, to be put together once all are measured."""

    def __init__(self) -> None:
        self._points: list[DosePoint] = []
        self._compared: list[StereoComparison] = []

    def add(self, offset_ms: float, frames: int, scored: StereoComparison) -> None:
        """Add the comparison of pictures so far apart with those of one instant."""
        self._compared.append(scored)
        self._points.append(DosePoint(offset_ms=offset_ms, offset_frames=frames, scores=scored.offset))

    @property
    def points(self) -> tuple[DosePoint, ...]:
        """The points of the curve, from the earliest to the latest."""
        widest = max(self._compared, key=lambda one: one.synced.instants)
        zero = DosePoint(offset_ms=0.0, offset_frames=0, scores=widest.synced)
        return tuple(sorted([*self._points, zero], key=lambda point: point.offset_ms))

    @property
    def measure(self) -> str:
        """Right depth where the truth is known, else any depth."""
        true = self._compared[0].synced.mover_within_2pct is not None
        return "mover_within_2pct" if true else "mover_coverage"

    @property
    def instants(self) -> tuple[DoseInstant, ...]:
        """Every instant's own curve over the points."""
        points = self.points
        pixels: dict[int, int] = {}
        found: dict[int, dict[float, float | None]] = {}
        for point, scored in zip(self._points, self._compared, strict=True):
            for row in scored.per_instant:
                now = int(row["instant"] or 0)
                pixels[now] = int(row["mover_pixels"] or 0)
                values = found.setdefault(now, {})
                values[0.0] = row[f"synced_{self.measure}"]
                values[point.offset_ms] = row[f"offset_{self.measure}"]
        return tuple(
            _instant(now, pixels[now], points, [found[now].get(point.offset_ms) for point in points])
            for now in sorted(found)
        )


def _instant(
    instant: int, pixels: int, points: Sequence[DosePoint], values: list[float | None]
) -> DoseInstant:
    known = {point.offset_ms: v for point, v in zip(points, values, strict=True) if v is not None}
    best = max(known, key=lambda ms: known[ms], default=None)
    peak = None
    if best is not None and len(known) > 1 and pixels >= MIN_COUNT:
        others = float(np.median([value for ms, value in known.items() if ms != best]))
        peak = best if known[best] - others >= CLEAR_PEAK else None
    return DoseInstant(instant=instant, mover_pixels=pixels, values=tuple(values), peak_ms=peak)


def is_decreasing(points: Sequence[DosePoint], measure: str) -> bool:
    """Whether, to either side of zero, no point's interval lies wholly above that of the one before it."""
    known = [
        [one for point in side if (one := point.scores.interval_of(measure)) is not None]
        for side in _sides(points)
    ]
    pairs = [pair for side in known for pair in pairwise(side)]
    return bool(pairs) and all(after.low <= before.high for before, after in pairs)


def tolerable_offset_ms(
    points: Sequence[DosePoint], measure: str, speed_px_per_ms: float | None
) -> float | None:
    """The offset at which a tenth is lost or half of what moves has moved by a pixel; None = neither."""
    limits = []
    for side in _sides(points):
        known = [
            (abs(p.offset_ms), one.value) for p in side if (one := p.scores.interval_of(measure)) is not None
        ]
        least = (1 - LOSS) * known[0][1] if known else 0.0
        for (before, high), (after, low) in pairwise(known):
            if low < least <= high:
                limits.append(before + (after - before) * (high - least) / (high - low))
                break
    if speed_px_per_ms:
        limits.append(1 / speed_px_per_ms)
    return min(limits) if limits else None


def _sides(points: Sequence[DosePoint]) -> tuple[list[DosePoint], list[DosePoint]]:
    """The points from zero to the earliest, and from zero to the latest."""
    early = [point for point in points if point.offset_ms <= 0]
    return early[::-1], [point for point in points if point.offset_ms >= 0]
