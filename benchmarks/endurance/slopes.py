"""Whether a figure grows: its slope over a run, past the time that a process needs to find its size."""

import statistics
from collections.abc import Sequence
from itertools import combinations

WARMING_UP = 0.35
"""Share of a run that does not count: pools fill, allocators grow, estimates settle."""
MOST_POINTS = 120
"""More are thinned out: all pairs of points have their say."""

Series = Sequence[tuple[float, float]]
"""Pairs of a place (a time, or a count of bursts) and a value."""


def settled(series: Series) -> Series:
    """Return what is past the warming up, thinned out evenly."""
    kept = series[int(WARMING_UP * len(series)) :]
    step = max(1, -(-len(kept) // MOST_POINTS))
    return kept[::step]


def slope(series: Series) -> float:
    """Return the median of the slopes of all pairs of points (Theil 1950, Sen 1968), 0 of one point."""
    slopes = [(b - a) / (at_b - at_a) for (at_a, a), (at_b, b) in combinations(series, 2) if at_b > at_a]
    return statistics.median(slopes) if slopes else 0.0


def growth(series: Series) -> float:
    """By how much a value grows, by its slope, from the warming up to the end of a run."""
    points = settled(series)
    return slope(points) * (points[-1][0] - points[0][0]) if len(points) > 1 else 0.0
