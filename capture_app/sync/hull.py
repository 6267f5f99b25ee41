"""The lower convex hull of points in a plane: no other points can touch a line from above."""

from collections.abc import Iterable
from typing import TypeVar

P = TypeVar("P", bound=tuple[float, float])


def lower_hull(points: Iterable[P]) -> list[P]:
    """Return the points (t, value) of the lower convex hull, by t (Andrew's monotone chain)."""
    hull: list[P] = []
    for point in sorted(points):
        t, v = point
        while len(hull) >= 2:
            (t1, v1), (t2, v2) = hull[-2], hull[-1]
            if (v2 - v1) * (t - t1) < (v - v1) * (t2 - t1):
                break
            hull.pop()
        hull.append(point)
    return hull
