"""Axes of charts that a template draws as SVG."""

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Axes:
    """A chart's view box and its margins; the vertical axis is a fraction, 0..1."""

    width: int
    height: int
    left: int
    right: int
    top: int
    bottom: int
    grid: Sequence[float]
    """Fractions at which a grid line is drawn."""
    below: str
    """Label of the horizontal axis."""

    def y(self, fraction: float) -> float:
        """Return the vertical coordinate of a fraction."""
        return round(self.height - self.bottom - (self.height - self.top - self.bottom) * fraction, 1)
