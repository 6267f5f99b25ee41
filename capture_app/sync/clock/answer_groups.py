"""Change detection on groups of clock samples: a stepped or slewed clock, or an increased path delay.

A changed clock shifts the bounds of both directions, one up and one down, and leaves the round-trip delay
unchanged. Load, or an attacker who delays messages, shifts one direction only. The round-trip delay then
grows by twice the apparent shift.
"""

from collections import deque
from collections.abc import Sequence
from itertools import accumulate, islice
from math import hypot, sqrt
from operator import add, sub
from typing import NamedTuple

from capture_app.sync.clock.likely_line import DRIFT, LONG_AGO_NS, STAMP_NS

HALF_SAMPLES, HALF_NS = 4, 70_000_000
"""Minimum samples of half a group, and minimum time from the first to the last of them.

The tightest bounds of two halves represent a group. WiFi delays come in spells of 0.1 to 0.3 s, and
shorter groups are not independent. At a request each 25 ms, a half takes three intervals.
"""
MIN_GROUPS, COUNTS = 12, (1, 2, 4, 8, 16, 32)
"""Minimum number of earlier groups for a test, and the numbers of newest groups that are tested."""


SIGMAS, TIMES_TYPICAL = 5.0, 1.5
"""A significant change exceeds this many sigma and this multiple of the largest earlier deviation.

False alarms in 0.37 h on eleven links, ten of them with spells (docs/accuracy-measurements.md): no step, 16
new lines, 22 longer paths.
"""
HIDDEN_SIGMAS = 2.0
"""Deviations up to this many sigma count as chance; the rest of larger ones is a possible error."""


Bound = tuple[int, int]
"""Local time and bound, both in ns; lower bounds are stored negated."""


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
    """Largest deviation of any equally long run of earlier groups; 0 where `moved` counts as chance."""
    min_skew: float
    """Lower bound of the clocks' relative rate, at SIGMAS sigma, from the earlier groups; dimensionless.

    The part that a steadily increasing path delay may explain, which shows in the round trips, is left out.
    """

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
        self.window_ns, self.half_ns = window_ns, HALF_NS
        self.clear()

    def clear(self) -> None:
        """Remove all groups, for a new estimate."""
        self._groups: deque[tuple[int, int, int]] = deque()
        """Mean time, offset and round-trip delay of each group, in ns."""
        self._sums: deque[tuple[int, ...]] = deque([(0,) * 8])
        """Sums over all groups so far, before the first of `_groups` and after each of them: number, time,
        offset, round trip, time squared, time times offset, offset squared, time times round trip."""
        self._uppers: list[Bound] = []
        self._lowers: list[Bound] = []
        self._half: tuple[Bound, Bound] | None = None
        """Tightest bounds of the half before the present one."""
        self._newest_ns = LONG_AGO_NS
        self._overlaps = True
        """Whether the last group shares its first half with the one before: the next one replaces it."""

    def forget_before(self, local_ns: int) -> None:
        """Remove the groups whose mean time is before a local time in ns."""
        while self._groups and self._groups[0][0] < local_ns:
            self._groups.popleft()
            self._sums.popleft()

    def add(self, upper: Bound, lower: Bound, skew: float) -> bool:
        """Add the bounds of one sample, the lower one negated. Return whether a group is complete."""
        if self._newest_ns < upper[0] - self.window_ns:
            self.clear()
        self._newest_ns = upper[0]
        self._uppers.append(upper)
        self._lowers.append(lower)
        if len(self._uppers) < HALF_SAMPLES or upper[0] - self._uppers[0][0] < self.half_ns:
            return False

        def tightest(uppers: Sequence[Bound], lowers: Sequence[Bound]) -> tuple[Bound, Bound]:
            return (
                min(uppers, key=lambda bound: bound[1] - skew * (bound[0] - upper[0])),
                min(lowers, key=lambda bound: bound[1] + skew * (bound[0] - upper[0])),
            )

        before, self._half = self._half, tightest(self._uppers, self._lowers)
        self._uppers, self._lowers = [], []
        if before is None:
            return False
        if self._overlaps and self._groups:
            self._groups.pop()
            self._sums.pop()
        self._overlaps = not self._overlaps
        (t0, above), (t3, below) = tightest(*zip(before, self._half, strict=True))
        t, offset, gap = (t0 + t3) // 2, (above - below) // 2, above + below - round(skew * (t0 - t3))
        self._groups.append((t, offset, gap))
        terms = 1, t, offset, gap, t * t, t * offset, offset * offset, t * gap
        self._sums.append(tuple(map(add, self._sums[-1], terms)))
        self.forget_before(upper[0] - self.window_ns)
        return True

    def newest(self) -> list[Newest]:
        """Return the deviations of the last 1, 2, 4, ... groups from the line through all earlier ones."""
        most = min(len(self._groups) // 2, len(self._groups) - MIN_GROUPS)
        return [self._compare(count) for count in COUNTS if count <= most]

    def _compare(self, count: int) -> Newest:
        """Return the deviation of the last `count` groups from the line through the groups before them."""
        between = self._sums[-1 - count]
        earlier, newest = map(sub, between, self._sums[0]), tuple(map(sub, self._sums[-1], between))
        many, times, offsets, gaps, squares, products, offset_squares, gap_products = earlier
        common = count * many
        # Differences of integers are exact: over hours, the sums have more digits than a float.
        scatter = max(1.0, (many * squares - times * times) / many)
        slope = (many * products - times * offsets) / many / scatter
        gap_slope = (many * gap_products - times * gaps) / many / scatter
        squared = (many * offset_squares - offsets * offsets) / many - slope**2 * scatter
        variance = max(0.0, squared) / (many - 2)

        ahead = (newest[1] * many - times * count) / common
        moved = (newest[2] * many - offsets * count) / common - slope * ahead
        chance = variance * (1.0 / count + 1.0 / many + ahead**2 / scatter)
        sigma = hypot(sqrt(chance), DRIFT * ahead**2 / 2.0, 2.0 * STAMP_NS)
        typical = 0.0
        if abs(moved) > HIDDEN_SIGMAS * sigma:
            level, middle = offsets / many, times / many
            residuals = [offset - level - slope * (t - middle) for t, offset, _ in islice(self._groups, many)]
            sums = list(accumulate(residuals, initial=0.0))
            typical = max(abs(end - begin) for begin, end in zip(sums, sums[count:], strict=False)) / count
        return Newest(
            since_ns=self._groups[-count][0],
            moved=moved,
            grown=(newest[3] * many - gaps * count) / common,
            sigma=sigma,
            typical=typical,
            min_skew=abs(slope) - abs(gap_slope) / 2.0 - SIGMAS * sqrt(variance / scatter),
        )
