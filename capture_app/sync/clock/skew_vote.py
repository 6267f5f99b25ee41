"""The most likely line between upper and lower bounds: the mean over all skews, weighted by likelihood."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import exp, sqrt

from capture_app.sync.clock.feasible_lines import lower_hull

VOTES = 33
SHARPEST = 5
"""How many of the tightest bounds of each direction tell how sharp their edge is."""
WIDTH = 0.5
"""Share of their spread that counts as one e-fold of likelihood; 0.2 to 0.8 do nearly as well."""
USUAL_SKEW = 20e-6
"""One sigma of the skew between two crystals, before anything is measured; the tails are a Student's."""

Point = tuple[float, float]
"""Time since the reference and bound, in ns; bounds from below with their sign turned."""


@dataclass(frozen=True, slots=True)
class VotedLine:
    """Offset (ns) at the reference and skew (dimensionless), with the spread of the votes."""

    offset: float
    skew: float
    variance: float
    covariance: float
    skew_variance: float
    gap: float
    """Largest gap between the two directions over all skews, in ns."""
    upper: Sequence[float]
    lower: Sequence[float]
    """The tightest bounds of each direction at that skew, the tightest first, in ns."""

    def spread_at(self, t: float, wander: float, span: float) -> tuple[float, float, float]:
        """Variance (ns squared), covariance with the skew (ns) and skew's variance, t ns after the reference.

        The votes take the clock for a straight line. Over the `span` in ns that was looked at its skew may
        have changed, by one sigma of `wander` each ns: the best line through a parabola lies below its end
        by wander * span^2 / 12, and is less steep there by wander * span / 2.
        """
        bend = wander * (span * span / 12.0 + span * t / 2.0 + t * t / 2.0)
        turn = wander * (span / 2.0 + t)
        variance = self.variance + 2.0 * self.covariance * t + self.skew_variance * t * t
        return (
            max(0.0, variance) + bend * bend,
            self.covariance + self.skew_variance * t + bend * turn,
            self.skew_variance + turn * turn,
        )


def vote_on_skews(
    uppers: Sequence[Point],
    lowers: Sequence[Point],
    runners_up: Callable[[float], tuple[list[float], list[float]]],
    *,
    steepest: float,
    count: int,
) -> VotedLine:
    """Average the lines of all skews up to `steepest`, weighted by the gap each leaves to the bounds.

    For one skew, the tightest bound of each direction gives the offset, and the gap between the two is the
    log-likelihood of exponential delays (Moon et al. 1999 take its maximum, a linear program). The gap is
    measured in units of the spread of the tightest of the `runners_up` (in any order, at a skew); `count` of
    these are kept. The mean over all skews is steadier than the maximum, and its spread says how well the
    skew is known.
    """
    room = _room(uppers, lowers)
    best = _highest(lambda skew: room(skew)[0], -steepest, steepest)
    above, below = (sorted(side)[:count] for side in runners_up(best))
    if min(len(above), len(below)) < SHARPEST:
        gap, offset = room(0.0)
        return VotedLine(offset, 0.0, 0.0, 0.0, USUAL_SKEW**2, abs(gap), (), ())
    gap, _ = room(best)
    spread = (above[SHARPEST - 1] - above[0] + below[SHARPEST - 1] - below[0]) / 2.0
    width = max(WIDTH * spread, 1.0)

    def lacks(skew: float) -> bool:
        return room(skew)[0] < gap - 8.0 * width

    first, last = _last_before(lacks, best, -steepest), _last_before(lacks, best, steepest)
    votes: list[tuple[float, float, float]] = []
    for i in range(VOTES):
        skew = first + (last - first) * i / (VOTES - 1)
        space, offset = room(skew)
        weight = exp(min(0.0, (space - gap) / width)) / (1.0 + (skew / USUAL_SKEW) ** 2 / 3.0) ** 2
        votes.append((weight, offset, skew))
    total = sum(w for w, _, _ in votes)
    mean = sum(w * offset for w, offset, _ in votes) / total
    mean_skew = sum(w * skew for w, _, skew in votes) / total
    return VotedLine(
        offset=mean,
        skew=mean_skew,
        variance=sum(w * (offset - mean) ** 2 for w, offset, _ in votes) / total,
        covariance=sum(w * (offset - mean) * (skew - mean_skew) for w, offset, skew in votes) / total,
        skew_variance=sum(w * (skew - mean_skew) ** 2 for w, _, skew in votes) / total,
        gap=abs(gap),
        upper=above,
        lower=below,
    )


def max_gap_line(
    uppers: Sequence[Point], lowers: Sequence[Point], steepest: float
) -> tuple[float, float, float]:
    """Return the skew, up to `steepest`, with the largest gap, that gap in ns, and the offset in ns."""
    room = _room(uppers, lowers)
    skew = _highest(lambda skew: room(skew)[0], -steepest, steepest)
    return skew, *room(skew)


def _room(uppers: Sequence[Point], lowers: Sequence[Point]) -> Callable[[float], tuple[float, float]]:
    """The gap between the two directions and its middle, both in ns, as a function of the skew."""
    above_hull, below_hull = lower_hull(uppers), lower_hull(lowers)

    def room(skew: float) -> tuple[float, float]:
        above = min([v - skew * t for t, v in above_hull])
        below = min([v + skew * t for t, v in below_hull])
        return above + below, (above - below) / 2.0

    return room


def _highest(concave: Callable[[float], float], low: float, high: float) -> float:
    """Where a concave function is highest, by golden section."""
    ratio = (sqrt(5.0) - 1.0) / 2.0
    a, b = high - ratio * (high - low), low + ratio * (high - low)
    at_a, at_b = concave(a), concave(b)
    for _ in range(28):
        if at_a < at_b:
            low, a, at_a = a, b, at_b
            b = low + ratio * (high - low)
            at_b = concave(b)
        else:
            high, b, at_b = b, a, at_a
            a = high - ratio * (high - low)
            at_a = concave(a)
    return (low + high) / 2.0


def _last_before(lacks: Callable[[float], bool], inside: float, outside: float) -> float:
    """The furthest skew from inside towards outside that does not lack room, by bisection."""
    if not lacks(outside):
        return outside
    for _ in range(14):
        middle = (inside + outside) / 2.0
        if lacks(middle):
            outside = middle
        else:
            inside = middle
    return outside
