"""All straight lines that a set of one-sided constraints leaves possible, as a convex polygon."""

Line = tuple[float, float]
"""A line's value at the reference, and its slope."""


class FeasibleLines:
    """Lines value + slope * t that respect every bound so far; t is counted from a fixed reference.

    Each line is a point of a (value, slope) plane, each bound at one t a half-plane of it, so what is left
    is a convex polygon. Values and t share one unit (ns in the engine), slopes are dimensionless.
    """

    __slots__ = ("corners",)

    def __init__(self, *, lowest: float, highest: float, steepest: float) -> None:
        self.corners: list[Line] = [
            (lowest, -steepest),
            (highest, -steepest),
            (highest, steepest),
            (lowest, steepest),
        ]

    @property
    def empty(self) -> bool:
        """No line is left: the bounds contradict each other."""
        return not self.corners

    def at_most(self, t: float, value: float) -> bool:
        """Keep the lines that are no higher than a value at t; say whether any line is left."""
        return self._clip(t, value, 1.0)

    def at_least(self, t: float, value: float) -> bool:
        """Keep the lines that are no lower than a value at t; say whether any line is left."""
        return self._clip(t, value, -1.0)

    def range_at(self, t: float) -> tuple[float, float]:
        """Lowest and highest value at t of the lines that are left; raises ValueError if there is none."""
        values = [value + slope * t for value, slope in self.corners]
        return min(values), max(values)

    def slopes(self) -> tuple[float, float]:
        """Least and greatest slope of the lines that are left; raises ValueError if there is none."""
        slopes = [slope for _, slope in self.corners]
        return min(slopes), max(slopes)

    def _clip(self, t: float, bound: float, sign: float) -> bool:
        excess = [sign * (value + slope * t - bound) for value, slope in self.corners]
        if not excess or max(excess) <= 0.0:
            return bool(excess)
        kept: list[Line] = []
        for i, (corner, over) in enumerate(zip(self.corners, excess, strict=True)):
            before, before_over = self.corners[i - 1], excess[i - 1]
            if (over > 0.0) != (before_over > 0.0):
                part = before_over / (before_over - over)
                kept.append(
                    (before[0] + part * (corner[0] - before[0]), before[1] + part * (corner[1] - before[1]))
                )
            if over <= 0.0:
                kept.append(corner)
        self.corners = kept
        return not self.empty
