"""A line fit that outliers hardly move."""

from collections.abc import Sequence
from math import sqrt
from statistics import median

SIGMA_FROM_MAD = 1.4826
HUBER = 1.345
"""Residuals beyond this many sigma lose weight (Huber 1964; 95 % efficient for normal noise)."""


def shared_slope(runs: Sequence[Sequence[tuple[float, float]]], start: float) -> tuple[float, float, float]:
    """Huber fit of one slope through several runs of (x, y), each run with a height of its own.

    Returns the slope, its standard deviation and the standard deviation of the noise, in units of y (per
    x). `start` is a slope near enough that residuals about it tell the outliers. Runs of fewer than three
    points are passed over; with none left, the answer is (start, infinity, 0).
    """
    usable = [run for run in runs if len(run) >= 3]
    if not usable:
        return start, float("inf"), 0.0
    slope, noise, spread = start, 0.0, 0.0
    heights = [median([y - slope * x for x, y in run]) for run in usable]
    for _ in range(4):
        residuals = [
            y - slope * x - height for run, height in zip(usable, heights, strict=True) for x, y in run
        ]
        noise = SIGMA_FROM_MAD * median([abs(r) for r in residuals])
        limit = HUBER * max(noise, 1.0)
        spread = product = 0.0
        for i, run in enumerate(usable):
            weights = [min(1.0, limit / max(abs(y - slope * x - heights[i]), 1.0)) for x, y in run]
            total = sum(weights)
            mean_x = sum(w * x for w, (x, _) in zip(weights, run, strict=True)) / total
            mean_y = sum(w * y for w, (_, y) in zip(weights, run, strict=True)) / total
            spread += sum(w * (x - mean_x) ** 2 for w, (x, _) in zip(weights, run, strict=True))
            product += sum(w * (x - mean_x) * (y - mean_y) for w, (x, y) in zip(weights, run, strict=True))
            heights[i] = mean_y - slope * mean_x
        if spread <= 0.0:
            return start, float("inf"), noise
        new_slope = product / spread
        heights = [
            h + (slope - new_slope) * sum(x for x, _ in run) / len(run)
            for h, run in zip(heights, usable, strict=True)
        ]
        slope = new_slope
    return slope, max(noise, 1.0) / sqrt(spread), noise
