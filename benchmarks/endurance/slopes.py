"""Growth of a figure over a run: its slope after the warm-up of the process."""

import statistics
from collections.abc import Sequence
from itertools import combinations

WARMING_UP = 0.35
"""Initial fraction of a run that is ignored: pools fill, allocators grow, estimates settle."""
MOST_POINTS = 120
"""Maximum number of points; more are thinned out, because all pairs of points are compared."""

Series = Sequence[tuple[float, float]]
"""Pairs of a place (a time, or a count of bursts) and a value."""


def settled(series: Series) -> Series:
    """Return the points after the warm-up, thinned out evenly."""
    kept = series[int(WARMING_UP * len(series)) :]
    step = max(1, -(-len(kept) // MOST_POINTS))
    return kept[::step]


def slope(series: Series) -> float:
    """Return the median slope over all pairs of points (Theil 1950, Sen 1968); 0 for one point."""
    slopes = [(b - a) / (at_b - at_a) for (at_a, a), (at_b, b) in combinations(series, 2) if at_b > at_a]
    return statistics.median(slopes) if slopes else 0.0


def growth(series: Series) -> float:
    """Return the growth of a value, by its slope, from the warm-up to the end of a run."""
    points = settled(series)
    return slope(points) * (points[-1][0] - points[0][0]) if len(points) > 1 else 0.0
