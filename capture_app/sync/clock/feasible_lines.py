"""The straight lines that satisfy a set of one-sided bounds, as a convex polygon of value and slope."""

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


Line = tuple[float, float]
"""A line's value at the reference, and its slope."""


class FeasibleLines:
    """Lines value + slope * t that respect every bound so far; t is counted from a fixed reference.

    Each line is a point of a (value, slope) plane, each bound at one t a half-plane of it, so what is left
    is a convex polygon. Values and t share one unit (ns in the engine), slopes are dimensionless.
    """

    __slots__ = ("_corners", "_highest", "_lowest", "_steepest")

    def __init__(self, *, lowest: float, highest: float, steepest: float) -> None:
        self.corners = [(lowest, -steepest), (highest, -steepest), (highest, steepest), (lowest, steepest)]

    @property
    def corners(self) -> list[Line]:
        """The polygon's corners, in order around it."""
        return self._corners

    @corners.setter
    def corners(self, corners: list[Line]) -> None:
        self._corners = corners
        values = [value for value, _ in corners]
        self._lowest, self._highest = min(values, default=0.0), max(values, default=0.0)
        self._steepest = max([abs(slope) for _, slope in corners], default=0.0)

    @property
    def empty(self) -> bool:
        """No line is left: the bounds contradict each other."""
        return not self._corners

    def bound_above(self, t: float, value: float) -> bool:
        """Keep the lines of at most this value at t; return whether any line is left."""
        # Most bounds are nowhere near: no line gets so high.
        if value >= self._highest + self._steepest * abs(t):
            return not self.empty
        return self._clip(t, value, 1.0)

    def bound_below(self, t: float, value: float) -> bool:
        """Keep the lines of at least this value at t; return whether any line is left."""
        if value <= self._lowest - self._steepest * abs(t):
            return not self.empty
        return self._clip(t, value, -1.0)

    def value_range_at(self, t: float) -> tuple[float, float]:
        """Lowest and highest value at t of the lines that are left; raises ValueError if there is none."""
        values = [value + slope * t for value, slope in self._corners]
        return min(values), max(values)

    def slope_range(self) -> tuple[float, float]:
        """Least and greatest slope of the lines that are left; raises ValueError if there is none."""
        slopes = [slope for _, slope in self._corners]
        return min(slopes), max(slopes)

    def _clip(self, t: float, bound: float, sign: float) -> bool:
        overshoots = [sign * (value + slope * t - bound) for value, slope in self._corners]
        if not overshoots or max(overshoots) <= 0.0:
            return bool(overshoots)
        kept: list[Line] = []
        for i, (corner, over) in enumerate(zip(self._corners, overshoots, strict=True)):
            before, before_over = self._corners[i - 1], overshoots[i - 1]
            if (over > 0.0) != (before_over > 0.0):
                part = before_over / (before_over - over)
                kept.append(
                    (before[0] + part * (corner[0] - before[0]), before[1] + part * (corner[1] - before[1]))
                )
            if over <= 0.0:
                kept.append(corner)
        self.corners = kept
        return not self.empty
