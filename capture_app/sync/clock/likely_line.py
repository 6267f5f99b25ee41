"""Most likely line between upper and lower bounds on a clock's offset: the mean over all possible skews.

The constants are the assumptions about clocks and links, one sigma each except MAX_SKEW.
docs/accuracy-measurements.md shows their effect. Skews are dimensionless (1e-6 is 1 ppm), times are in ns.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from heapq import nsmallest
from itertools import pairwise
from math import exp, pi, sqrt
from statistics import fmean
from typing import NamedTuple

LONG_AGO_NS = -(2**66)
"""Before any time of any clock."""
MAX_SKEW = 1010e-6
"""Assumption of the hard bound: 1000 ppm, in either clock's seconds. Crystals are within 100 ppm, and an NTP
daemon slews by 500 (adjtimex(2))."""
SKEW = 25e-6
"""Skew between two crystals; data sheets of those in computers and phones allow 20 to 50 ppm each."""
ODD_HOSTS = 3e-4
"""Prior density of any larger skew up to MAX_SKEW, relative to zero skew: virtual machines, slewed hosts.

On the paper's link a clock 300 ppm fast was 95 us off after 5 s on average, and its bar held in 94 % of the
first 10 s; with ten times as much, 27 and 99 %, and crystals on WiFi are ready after 1.9 s instead of 1.75.
"""
EVEN_ODDS = SKEW * sqrt(2.0 * pi) / (2.0 * MAX_SKEW)
"""The same after a clock has changed: it is as likely to be slewed, at any rate, as at rest."""
DRIFT = 0.025e-6 / 1e9
"""Change of a skew per ns that the samples do not show yet: a crystal that warms up has up to 0.05 ppm/s."""
ASYMMETRY = 0.1
"""Half the difference of the two minimum delays, as a fraction of half the minimum round-trip delay.

No exchange can show a lasting asymmetry, and no recording here does: the first one's two least delays were
set equal. What changes within it: 0.095 in windows of 4 s, 0.075 in 30 s of an 802.11 link
(tests.unit.benchmarks.simulated.link_spells prints both); 0.038 in the one fastest message of another
(Ansari et al. 2019, table III); 0.010 on Ethernet (Ha et al. 2024, whose data contain the true offsets).
WiFi chipsets are slower in one direction in general (Mahmood, Exel and Sauter 2014).

The first recording has no long tail: 95 % of its windows of 4 s are below 0.152, where this prior has 0.196.
That covers 67 % of links drawn with 0.2 (a normal distribution), and half of those that have exactly that.
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
LONE_RATIO, MAX_LONE = 2.0, 24
"""Delays are lone if they are this many times as far below the next one as that one is below the seventh
after it; and their maximum number. Of 300 equally dense delays, 1.1 % of the draws have such ones.

On the paper's link one message in eighty is 0.37 ms faster than the rest, mostly in both directions. When
they counted like all others, its errors after 2, 4 and 10 s were 35, 30 and 25 us on average and 218, 163 and
107 at most; now they are 19, 17 and 16, and 70, 98 and 35 (100 trials). On eight other links they are equal.
With a maximum of 12, a phone 40 ppm fast had a skew of 8 +- 39 ppm from the 13th on, and was 167 us off 6 s
later; now it has 41 +- 4 ppm and is at most 49 us off.
"""
ROUNDS = 4
"""Maximum number of times that the lone delays are searched for, each time with the skew of the others.

With one round, skews were up to 25 ppm wrong after 8 s on the paper's link, and errors up to 160 us; now 14
and 51 (40 trials).
"""
MAX_ONE_SIDED = 6
"""Maximum number of lone messages of one direction that may be due to chance if the other one has none.

With 12, one trial in 100 ignored the faster path at 30 s; with 4, one in 100 did not ignore it at 2 s.
"""
_NEAR = [0.0, *(sign * 4e-9 * 2.0**k for k in range(18) for sign in (-1.0, 1.0))]
"""Distances from the best skew at which the likelihood is evaluated: they double from 4 ppb on, so that no
sharp likelihood falls between two of them."""
_PRIOR_SKEWS = [k * 12e-6 for k in range(-8, 9)]
"""Skews at which it is evaluated, too: half a SKEW apart, for a flat likelihood."""

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
    """Minimum round-trip delay in ns; negative if the bounds contradict each other."""
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
    uppers: Sequence[Point],
    above: Sequence[Point],
    lowers: Sequence[Point],
    below: Sequence[Point],
    *,
    odd: float = ODD_HOSTS,
) -> LikelyLine:
    """Return the mean line over all skews, weighted by their prior and by the gap between the directions.

    At a given skew the tightest bound of each direction gives the offset. The gap between the two is the
    log-likelihood of exponential delays (Moon et al. 1999 take its maximum, a linear program). `above` and
    `below` are the lower hulls of the upper and of the lower bounds, `odd` the prior density of large skews.

    A few lone messages that are far faster than all others hide what the others tell of the skew, which
    therefore comes from both: the gap of all, and that of the dense delays. Lone ones of only one direction
    tell nothing about the offset, as the other direction has a faster path, too.
    """
    sides, hulls = (uppers, lowers), (above, below)
    everything = _gap(sides, hulls)
    votes = _vote(odd, everything)
    dense, lone, skew = everything, [0, 0], sum(weight * skew for weight, skew, _ in votes)
    for _ in range(ROUNDS):
        levels, before = _levels(sides, skew), lone
        firsts = [_first_dense(side) for side in levels]
        lone = [sum(level < first for level in side) for side, first in zip(levels, firsts, strict=True)]
        if lone == before:
            break
        dense_bounds = [
            [point for point, level in zip(points, side, strict=True) if level >= first]
            for points, side, first in zip(sides, levels, firsts, strict=True)
        ]
        dense = _gap(dense_bounds, [lower_hull(points) for points in dense_bounds])
        skew = dense.best
    excess, used = everything.excess, 0
    if any(lone):
        votes = _vote(odd, everything, dense)
        excess = max(excess, dense.excess)
        used = 1 if _is_one_sided(levels, firsts, lone) else 0
    lines = [(weight, offsets[used], skew) for weight, skew, offsets in votes]
    mean, slope = sum(w * o for w, o, _ in lines), sum(w * s for w, _, s in lines)
    return LikelyLine(
        offset=mean,
        skew=slope,
        variance=sum(w * (o - mean) ** 2 for w, o, _ in lines),
        covariance=sum(w * (o - mean) * (s - slope) for w, o, s in lines),
        skew_variance=sum(w * (s - slope) ** 2 for w, _, s in lines),
        gap=everything.gap,
        excess=excess,
    )


def gap_of(uppers: Sequence[Point], lowers: Sequence[Point]) -> tuple[float, float]:
    """Return the gap of the line through some bounds, in ns, and its `excess`, in ns squared."""
    gap = _gap((uppers, lowers), (lower_hull(uppers), lower_hull(lowers)))
    return gap.gap, gap.excess


class _Gap(NamedTuple):
    """Gap between the directions, which is largest at the skew `best`; in ns."""

    hulls: Sequence[Sequence[Point]]
    best: float
    gap: float
    width: float
    """Decrease of the gap that is one e-fold of likelihood."""
    excess: float
    """Variance of the excess of the smallest delays over the minimum ones."""


def _room(hulls: Sequence[Sequence[Point]], skew: float) -> tuple[float, float]:
    """Return the gap between the directions at a skew, and the offset in its middle."""
    high, low = min([v - skew * t for t, v in hulls[0]]), min([v + skew * t for t, v in hulls[1]])
    return high + low, (high - low) / 2.0


def _levels(sides: Sequence[Sequence[Point]], skew: float) -> list[list[float]]:
    """Return the bounds of both directions at the reference time, if the skew is this one."""
    return [[v - slope * t for t, v in points] for points, slope in zip(sides, (skew, -skew), strict=True)]


def _gap(sides: Sequence[Sequence[Point]], hulls: Sequence[Sequence[Point]]) -> _Gap:
    """Return the gap between the directions, and what the distances of the tightest bounds say of it."""
    best, mean_distances = 0.0, [_room(hulls, 0.0)[0]] * 2
    near = mean_distances
    if min(map(len, sides)) >= TIGHTEST:
        # The gap is concave and piecewise linear in the skew, with corners at the slopes of the hulls.
        corners = [
            sign * (v2 - v1) / (t2 - t1)
            for hull, sign in zip(hulls, (1.0, -1.0), strict=True)
            for (t1, v1), (t2, v2) in pairwise(hull)
        ]
        best = max([s for s in corners if abs(s) < MAX_SKEW], key=lambda s: _room(hulls, s)[0], default=0.0)
        intercepts = [
            list(zip(levels, [t for t, _ in points], strict=True))
            for levels, points in zip(_levels(sides, best), sides, strict=True)
        ]
        mean_distances, near = map(list, zip(*map(_mean_distances, intercepts), strict=True))
    one, other = mean_distances
    excess = ((one - other) ** 2 + EXCESS**2 * (one**2 + other**2)) / 4.0
    # One e-fold of likelihood is the mean distance of the nearest. With 0.55 of it, which fits exponential
    # delays, the skew follows a few lucky messages: 435 us at most 1.3 s after 300 gamma 3 delays, where this
    # has 216 (100 trials).
    return _Gap(hulls, best, _room(hulls, best)[0], max(sum(near) / 2.0, 1.0), excess)


def _vote(odd: float, *gaps: _Gap) -> list[tuple[float, float, tuple[float, ...]]]:
    """Return weight, skew and each gap's offset of all skews, weighted by the product of the likelihoods."""
    sharpest = min(gaps, key=lambda one: one.width)
    skews = {*(sharpest.best + step for step in _NEAR), *_PRIOR_SKEWS}
    grid = sorted(skew for skew in skews if abs(skew) <= MAX_SKEW)
    found = []
    for before, skew, after in zip(grid, grid[1:], grid[2:], strict=False):
        rooms = [_room(one.hulls, skew) for one in gaps]
        lost = sum(max(0.0, one.gap - left) / one.width for one, (left, _) in zip(gaps, rooms, strict=True))
        prior = exp(-0.5 * (skew / SKEW) ** 2) + odd
        found.append((lost, (after - before) * prior, skew, tuple(offset for _, offset in rooms)))
    # Two gaps may contradict each other: relative to the best skew, so that not all weights are zero.
    minimum = min(lost for lost, *_ in found)
    votes = [(exp(minimum - lost) * prior, skew, offsets) for lost, prior, skew, offsets in found]
    total = sum(weight for weight, _, _ in votes)
    return [(weight / total, skew, offsets) for weight, skew, offsets in votes]


def _first_dense(levels: Sequence[float]) -> float:
    """Return the lowest level above the lone ones; the lowest of all if none is lone."""
    tightest = sorted(levels)[: MAX_LONE + TIGHTEST]
    for i in range(len(tightest) - TIGHTEST, 0, -1):
        if tightest[i] - tightest[i - 1] > LONE_RATIO * (tightest[i + TIGHTEST - 1] - tightest[i]):
            return tightest[i]
    return tightest[0]


def _is_one_sided(levels: Sequence[Sequence[float]], firsts: Sequence[float], lone: Sequence[int]) -> bool:
    """Whether only one direction has lone messages, and the other has more than these near its minimum."""
    if min(lone) or max(lone) > MAX_ONE_SIDED:
        return False
    side = lone.index(max(lone))
    near = firsts[1 - side] + (firsts[side] - min(levels[side])) / 2.0
    return sum(level < near for level in levels[1 - side]) >= TIGHTEST + lone[side]


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
