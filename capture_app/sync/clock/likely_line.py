"""Most likely line between upper and lower bounds on a clock's offset: the mean over all possible skews.

The constants are the assumptions about clocks and links, one sigma each except MAX_SKEW.
docs/accuracy-measurements.md shows their effect. Skews are dimensionless (1e-6 is 1 ppm), times are in ns.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from heapq import nsmallest
from itertools import pairwise
from math import exp
from statistics import fmean

LONG_AGO_NS = -(2**66)
"""Before any time of any clock."""
MAX_SKEW = 1010e-6
"""Assumption of the hard bound: 1000 ppm, in either clock's seconds. Crystals are within 100 ppm, and an NTP
daemon slews by 500 (adjtimex(2))."""
SKEW = 25e-6
"""Skew between two crystals; data sheets of those in computers and phones allow 20 to 50 ppm each."""
ODD_HOSTS = 3e-4
"""Prior density of any larger skew up to MAX_SKEW, relative to zero skew: virtual machines, slewed hosts."""
DRIFT = 0.025e-6 / 1e9
"""Change of a skew per ns that the samples do not show yet: a crystal that warms up has up to 0.05 ppm/s."""
ASYMMETRY = 0.1
"""Half the difference of the two minimum delays, as a fraction of half the minimum round-trip delay.

No two-way message can show it. Recorded links: 0.095 in windows of 4 s, 0.075 in 30 s of an 802.11 link
(tests.simulation.link_spells prints both); 0.038 in the one fastest message of another (Ansari et al.
2019, table III); 0.010 on Ethernet (Ha et al. 2024, whose data contain the true offsets). WiFi chipsets are
slower in one direction in general (Mahmood, Exel and Sauter 2014). Of links drawn with 0.2, a 95 % bar of
this width holds for 84 %.
"""
STAMP_NS = 1_000.0
"""Asymmetry of two programs: one that was just woken up takes its timestamps late (real; on loopback and
cables)."""
EXCESS = 0.7
"""Uncertainty of the estimated minimum delay, as a fraction of its correction.

The smallest measured delay exceeds the minimum by the mean distance to the next smallest ones, give or take
this fraction. Chosen on 28 delay distributions that no experiment uses.
"""


SPELL_NS = 200e6
"""Time within which delays may share one disturbance, so that their minimum counts as one message.

Spells of WiFi delays last 0.1 to 0.3 s. With the recorded link in order, the 95 % bar held for 93.4 %
without this, 96.7 % with it, and 99.0 % with 500 ms, at a mean of 210, 238 and 250 us (16 trials of 30 s).
Independent delays have the same bar in all three.
"""
TIGHTEST = 8
"""Number of tightest bounds of each direction that show the distance of the tightest to the minimum delay."""
NEAREST, NEAREST_FRACTION = 4, 0.5
"""The nearest of them are about half as far from it (Gamma 2: 0.52, exponential: 0.43).

If a few messages are far faster than all others, the distance to the others is irrelevant for the likelihood.
"""
WIDTH = 0.55
"""Fraction of their mean distance to it that is one e-fold of likelihood."""
_NEAR = [0.0, *(sign * 4e-9 * 2.0**k for k in range(18) for sign in (-1.0, 1.0))]
_PRIOR_SKEWS = [k * 12e-6 for k in range(-8, 9)]

Point = tuple[float, float]
"""Time since the reference and bound, in ns; lower bounds are negated."""


@dataclass(frozen=True, slots=True)
class LikelyLine:
    """Offset (ns) at the reference and skew (dimensionless), with their variances and covariance."""

    offset: float
    skew: float
    variance: float
    covariance: float
    skew_variance: float
    gap: float
    """Minimum round-trip delay in ns."""
    excess: float
    """Variance of the excess of the smallest measured delays over the minimum delays, in ns squared."""

    def variance_at(self, t: float) -> float:
        """Return the variance of the line t ns after the reference, in ns squared."""
        return self.excess + max(0.0, self.variance + (2.0 * self.covariance + self.skew_variance * t) * t)


def lower_hull(points: Iterable[Point]) -> list[Point]:
    """Return the points (t, value) of the lower convex hull, by t (Andrew's monotone chain)."""
    hull: list[Point] = []
    for t, v in sorted(points):
        if hull and t == hull[-1][0]:
            continue
        while len(hull) >= 2:
            (t1, v1), (t2, v2) = hull[-2], hull[-1]
            if (v2 - v1) * (t - t1) < (v - v1) * (t2 - t1):
                break
            hull.pop()
        hull.append((t, v))
    return hull


def fit_line(
    uppers: Sequence[Point], above: Sequence[Point], lowers: Sequence[Point], below: Sequence[Point]
) -> LikelyLine:
    """Return the mean line over all skews, weighted by their prior and by the gap between the directions.

    At a given skew the tightest bound of each direction gives the offset. The gap between the two is the
    log-likelihood of exponential delays (Moon et al. 1999 take its maximum, a linear program). `above` and
    `below` are the lower hulls of the upper and of the lower bounds.
    """

    def room(skew: float) -> tuple[float, float]:
        high, low = min([v - skew * t for t, v in above]), min([v + skew * t for t, v in below])
        return high + low, (high - low) / 2.0

    best, mean_distances = 0.0, [room(0.0)[0]] * 2
    near = mean_distances
    if min(len(uppers), len(lowers)) >= TIGHTEST:
        # The gap is concave and piecewise linear in the skew, with corners at the slopes of the hulls.
        corners = [(v2 - v1) / (t2 - t1) for (t1, v1), (t2, v2) in pairwise(above)]
        corners += [(v1 - v2) / (t2 - t1) for (t1, v1), (t2, v2) in pairwise(below)]
        best = max([s for s in corners if abs(s) < MAX_SKEW], key=lambda skew: room(skew)[0], default=0.0)
        intercepts = [(v - best * t, t) for t, v in uppers], [(v + best * t, t) for t, v in lowers]
        mean_distances, near = map(list, zip(*map(_mean_distances, intercepts), strict=True))
    gap, width = room(best)[0], max(WIDTH * sum(near) / 2.0, 1.0)
    grid = sorted({s for s in (*[best + step for step in _NEAR], *_PRIOR_SKEWS) if abs(s) <= MAX_SKEW})
    votes: list[tuple[float, float, float]] = []
    for before, skew, after in zip(grid, grid[1:], grid[2:], strict=False):
        left, offset = room(skew)
        prior = exp(-0.5 * (skew / SKEW) ** 2) + ODD_HOSTS
        votes.append(((after - before) * prior * exp(min(0.0, left - gap) / width), offset, skew))
    total = sum(w for w, _, _ in votes)
    mean, slope = sum(w * o for w, o, _ in votes) / total, sum(w * s for w, _, s in votes) / total
    return LikelyLine(
        offset=mean,
        skew=slope,
        variance=sum(w * (o - mean) ** 2 for w, o, _ in votes) / total,
        covariance=sum(w * (o - mean) * (s - slope) for w, o, s in votes) / total,
        skew_variance=sum(w * (s - slope) ** 2 for w, _, s in votes) / total,
        gap=abs(gap),
        excess=(
            (mean_distances[0] - mean_distances[1]) ** 2
            + EXCESS**2 * (mean_distances[0] ** 2 + mean_distances[1] ** 2)
        )
        / 4.0,
    )


def _mean_distances(levels: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Return the mean distance of the TIGHTEST levels from their minimum, and twice that of the nearest.

    `levels` are pairs of a level and its time, in ns. Where the tightest levels of different spells are
    farther from it, they count: as many, from the smaller half of all spells.
    """
    tightest = nsmallest(TIGHTEST, levels)
    of_spells = tightest
    if len({t // SPELL_NS for _, t in tightest}) < TIGHTEST:
        minima = {t // SPELL_NS: (level, t) for level, t in sorted(levels, reverse=True)}
        of_spells = nsmallest(min(TIGHTEST, (len(minima) + 1) // 2), minima.values())
    mean_distance, nearest = (
        max(fmean([level for level, _ in some[:count]]) for some in (tightest, of_spells)) - tightest[0][0]
        for count in (TIGHTEST, NEAREST)
    )
    return mean_distance, min(nearest / NEAREST_FRACTION, mean_distance)
