"""Change detection on groups of clock samples: a stepped or slewed clock, or an increased path delay.

A changed clock shifts the bounds of both directions, one up and one down, and leaves the round-trip delay
unchanged. Load, or an attacker who delays messages, shifts one direction only. The round-trip delay then
grows by twice the apparent shift.
"""

from collections import deque
from collections.abc import Sequence
from itertools import accumulate
from math import hypot, sqrt
from operator import sub
from typing import NamedTuple

from capture_app.sync.clock.likely_line import DRIFT, STAMP_NS

GROUP = 8
"""Samples in a group; the tightest bound of each direction represents them."""
MIN_GROUPS, COUNTS = 12, (1, 2, 4, 8, 16, 32)
"""Minimum number of earlier groups for a test, and the numbers of newest groups that are tested."""


SIGMAS, TIMES_TYPICAL = 5.0, 1.5
"""A significant change exceeds this many sigma and this multiple of the largest earlier deviation."""
HIDDEN_SIGMAS = 2.0
"""Deviations up to this many sigma count as chance; the rest of larger ones is a possible error."""


class Newest(NamedTuple):
    """Deviation of the newest groups from a straight line through the earlier ones; in ns."""

    since_ns: int
    """Local time of the first of the newest groups."""
    moved: float
    """Mean deviation of the offset: positive if the leader's clock is later than the line predicts."""
    grown: float
    """Mean increase of the round-trip delay."""
    sigma: float
    """One sigma of `moved`."""
    typical: float
    """Largest deviation of any equally long run of earlier groups."""
    min_skew: float
    """Lower bound of the clocks' relative rate, at SIGMAS sigma, from the earlier groups; dimensionless."""

    @property
    def is_beyond_chance(self) -> bool:
        """Whether the deviation is significant: a clock or a path has changed."""
        return abs(self.moved) > max(SIGMAS * self.sigma, TIMES_TYPICAL * self.typical)

    @property
    def hidden(self) -> float:
        """Possible error of the line in ns that its uncertainty does not include."""
        if self.is_beyond_chance:
            return 2.0 * abs(self.moved)
        return abs(self.moved) - max(HIDDEN_SIGMAS * self.sigma, self.typical) if self.is_of_clock else 0.0

    @property
    def is_of_clock(self) -> bool:
        """Whether the deviation fits a changed clock rather than a changed path delay."""
        return self.grown <= abs(self.moved)


class AnswerGroups:
    """Groups of the last `window_ns`, each reduced to the tightest bound of each direction."""

    def __init__(self, window_ns: int) -> None:
        self.window_ns = window_ns
        self.clear()

    def clear(self) -> None:
        """Remove all groups."""
        self._groups: deque[tuple[int, float, float]] = deque()
        """Mean time, offset and round-trip delay of each group."""
        self._uppers: deque[tuple[int, int]] = deque(maxlen=GROUP)
        self._lowers: deque[tuple[int, int]] = deque(maxlen=GROUP)
        self._count = 0

    def forget_before(self, local_ns: int) -> None:
        """Remove the groups whose mean time is before a local time in ns."""
        while self._groups and self._groups[0][0] < local_ns:
            self._groups.popleft()

    def add(self, upper: tuple[int, int], lower: tuple[int, int], skew: float) -> bool:
        """Add the bounds of one sample, the lower one negated. Return whether a group is complete."""
        if self._uppers and self._uppers[-1][0] < upper[0] - self.window_ns:
            self.clear()
        self._uppers.append(upper)
        self._lowers.append(lower)
        self._count += 1
        if len(self._uppers) < GROUP or self._count % (GROUP // 2):
            return False
        if self._count % GROUP == 0 and self._groups:
            # The last group shares half of its samples with this one, which replaces it.
            # After a long pause there may be none.
            self._groups.pop()
        (t0, above) = min(self._uppers, key=lambda bound: bound[1] - skew * (bound[0] - upper[0]))
        (t3, below) = min(self._lowers, key=lambda bound: bound[1] + skew * (bound[0] - upper[0]))
        self._groups.append(((t0 + t3) // 2, (above - below) / 2.0, above + below - skew * (t0 - t3)))
        self.forget_before(upper[0] - self.window_ns)
        return True

    def newest(self) -> list[Newest]:
        """Return the deviations of the last 1, 2, 4, ... groups from the line through all earlier ones."""
        if not self._groups:
            return []
        at_ns, level = self._groups[-1][:2]
        points = [(float(t - at_ns), offset - level, gap) for t, offset, gap in self._groups]
        terms = [(t, x, gap, t * t, t * x, x * x) for t, x, gap in points]
        sums = [list(accumulate(column, initial=0.0)) for column in zip(*terms, strict=True)]
        total = len(points)
        return [
            self._compare(sums, count)
            for count in COUNTS
            if count <= total // 2 and total - count >= MIN_GROUPS
        ]

    def _compare(self, sums: Sequence[Sequence[float]], count: int) -> Newest:
        """Return the deviation of the last `count` groups from the line through the groups before them.

        `sums` holds the cumulative sums, starting at 0, of times, offsets, round-trip delays, squared times,
        products of time and offset, and squared offsets.
        """
        times, offsets, gaps, squares, products, offset_squares = sums
        many = len(times) - 1 - count
        middle, level, gap = times[many] / many, offsets[many] / many, gaps[many] / many
        scatter = max(1.0, squares[many] - many * middle**2)
        slope = (products[many] - many * middle * level) / scatter
        variance = max(0.0, offset_squares[many] - many * level**2 - slope**2 * scatter) / (many - 2)

        intercept = level - slope * middle
        sloped = [offset - slope * time for offset, time in zip(offsets, times, strict=True)]
        earlier = list(map(sub, sloped[count : many + 1], sloped))
        ahead = (times[-1] - times[many]) / count - middle
        chance = variance * (1.0 / count + 1.0 / many + ahead**2 / scatter)
        return Newest(
            since_ns=self._groups[-count][0],
            moved=(sloped[-1] - sloped[many]) / count - intercept,
            grown=(gaps[-1] - gaps[many]) / count - gap,
            sigma=hypot(sqrt(chance), DRIFT * ahead**2 / 2.0, 2.0 * STAMP_NS),
            min_skew=abs(slope) - SIGMAS * sqrt(variance / scatter),
            typical=max(max(earlier) / count - intercept, intercept - min(earlier) / count),
        )
