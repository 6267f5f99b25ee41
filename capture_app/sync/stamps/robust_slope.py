"""A line fit that outliers hardly move."""

from collections.abc import Sequence
from math import sqrt
from statistics import median

SIGMA_FROM_MAD = 1.4826
ROUNDS = 4
HUBER = 1.345
"""Residuals beyond this many sigma lose weight (Huber 1964; 95 % efficient for normal noise)."""


def fit_shared_slope(
    runs: Sequence[Sequence[tuple[float, float]]], start: float
) -> tuple[float, float, float]:
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
    for _ in range(ROUNDS):
        misses = [
            [y - slope * x - height for x, y in run] for run, height in zip(usable, heights, strict=True)
        ]
        noise = SIGMA_FROM_MAD * median([abs(miss) for run in misses for miss in run])
        limit = HUBER * max(noise, 1.0)
        spread = product = 0.0
        means = []
        for run, run_misses in zip(usable, misses, strict=True):
            first_x = run[0][0]
            total = sum_x = sum_miss = sum_xx = sum_x_miss = 0.0
            for (x, _), miss in zip(run, run_misses, strict=True):
                weight = 1.0 if -limit <= miss <= limit else limit / abs(miss)
                along = x - first_x
                weighed = weight * along
                total += weight
                sum_x += weighed
                sum_miss += weight * miss
                sum_xx += weighed * along
                sum_x_miss += weighed * miss
            spread += sum_xx - sum_x * sum_x / total
            product += sum_x_miss - sum_x * sum_miss / total
            means.append((first_x + sum_x / total, sum_miss / total))
        if spread <= 0.0:
            return start, float("inf"), noise
        turn = product / spread
        slope += turn
        heights = [
            height + mean_miss - turn * mean_x
            for height, (mean_x, mean_miss) in zip(heights, means, strict=True)
        ]
    return slope, max(noise, 1.0) / sqrt(spread), noise
