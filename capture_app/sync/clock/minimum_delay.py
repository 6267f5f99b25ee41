"""How far the least delay measured lies above the link's minimum delay, judged by the spacing of the least.

Near its minimum a law of delays is taken to grow like a power of the distance, whatever law it is. Power
and distance are unknown; both are averaged over, so that no law has to be named.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import erf, exp, log, sqrt

MEAN_POWER, POWER_SHAPE = 2.25, 2.0
"""Mean and shape of the Gamma prior of the power: 1 exponential delays, 2 Gamma(2), 5 few short ones."""
NEARNESS = 0.95
"""The prior of the distance is the distance to minus this power; 1 would be free of scale.

These, and the number of delays that are looked at, were chosen on 28 laws that the experiments do not use
(docs/accuracy.md, "How ours comes by its uncertainty").
"""
NEAREST, FURTHEST, STEPS = 0.01, 8.0, 24
"""Distances tried, in units of the spread of the delays."""
_RATIO = (FURTHEST / NEAREST) ** (1.0 / (STEPS - 1))
_DISTANCES = tuple(NEAREST * _RATIO**i for i in range(STEPS))


@dataclass(frozen=True, slots=True)
class DelayExcess:
    """Mean (ns) and variance (ns squared) of the least delay measured minus the minimum delay."""

    mean: float
    variance: float


def estimate_excess(least: Sequence[float]) -> DelayExcess:
    """Estimate it from the least delays in ascending order, in ns; all may contain the same unknown constant.

    The joint density of the m least of many delays with minimum delay a and power k is k^m exp(-k S) over the
    product of (x - a), S the sum of log((x_m - a) / (x - a)); the scale is integrated out before, k after
    (Hall 1982, "On estimating the endpoint of a distribution", has the maximum of the same likelihood).
    """
    count = len(least)
    spread = least[-1] - least[0] if count else 0.0
    if spread <= 0.0:
        return DelayExcess(0.0, 0.0)
    above = [(x - least[0]) / spread for x in least]
    weighed: list[tuple[float, float]] = []
    for distance in _DISTANCES:
        logs = [log(x + distance) for x in above]
        total = sum(logs)
        steepness = count * logs[-1] - total + POWER_SHAPE / MEAN_POWER
        # A step of the distances is proportional to the distance itself.
        weight = (1.0 - NEARNESS) * log(distance) - total - (count + POWER_SHAPE) * log(steepness)
        weighed.append((weight, distance))
    most = max(weight for weight, _ in weighed)
    shares = [(exp(weight - most), distance) for weight, distance in weighed]
    total = sum(share for share, _ in shares)
    mean = sum(share * distance for share, distance in shares) / total
    variance = sum(share * (distance - mean) ** 2 for share, distance in shares) / total
    return DelayExcess(mean * spread, variance * spread * spread)


def radius_95(mean: float, sigma: float) -> float:
    """Half the width of the interval around zero that holds 95 % of a normal law, in the unit of both."""
    if sigma <= 0.0:
        return abs(mean)
    low, high = abs(mean), abs(mean) + 2.0 * sigma
    for _ in range(20):
        middle = (low + high) / 2.0
        held = erf((middle - mean) / (sigma * sqrt(2.0))) + erf((middle + mean) / (sigma * sqrt(2.0)))
        if held < 2.0 * 0.95:
            low = middle
        else:
            high = middle
    return high
