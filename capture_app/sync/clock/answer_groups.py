"""Groups of answers: do the newest ones tell of another clock, or of a longer way, than those before?

A clock that changes moves both directions, one up and one down, and leaves the round trip as it is. Load, or
somebody who holds messages back, moves one direction only, and makes the round trip twice as much longer.
"""

from collections import deque
from collections.abc import Sequence
from itertools import accumulate
from math import hypot, sqrt
from operator import sub
from typing import NamedTuple

from capture_app.sync.clock.likely_line import DRIFT, STAMP_NS

GROUP = 8
"""Answers of a group, of which the tightest bound of each direction counts."""
LEAST_GROUPS, COUNTS = 12, (1, 2, 4, 8, 16, 32)
"""With fewer before them nothing is said of the newest ones: the last one, the last two, four and so on."""


SIGMAS, TIMES_USUAL = 5.0, 1.5
"""What is beyond chance is so many sigma away, and so many times as far as any were before."""
HIDDEN_SIGMAS = 2.0
"""What is less is chance; what is more the line may be off by, though it is not beyond chance."""


class Newest(NamedTuple):
    """How the newest groups lie to a straight line through those before; in ns."""

    since_ns: int
    """Local time of the first of them."""
    moved: float
    """By how much later, on average, the leader's clock is by them."""
    grown: float
    """By how much their round trips are longer."""
    doubt: float
    """One sigma of `moved`."""
    usual: float
    """The furthest that as many groups in a row were off before."""
    least_skew: float
    """The clocks run apart by so much at least, beyond chance, by the groups before; dimensionless."""

    @property
    def is_beyond_chance(self) -> bool:
        """Whether something has changed."""
        return abs(self.moved) > max(SIGMAS * self.doubt, TIMES_USUAL * self.usual)

    @property
    def hidden(self) -> float:
        """By how much more than by chance the line may be off, in ns."""
        if self.is_beyond_chance:
            return 2.0 * abs(self.moved)
        return abs(self.moved) - max(HIDDEN_SIGMAS * self.doubt, self.usual) if self.is_of_clock else 0.0

    @property
    def is_of_clock(self) -> bool:
        """Whether it would be a clock that changed, and not one of the ways."""
        return self.grown <= abs(self.moved)


class AnswerGroups:
    """The groups of the last `window_ns`, as the tightest bounds of each direction."""

    def __init__(self, window_ns: int) -> None:
        self.window_ns = window_ns
        self.clear()

    def clear(self) -> None:
        """Forget all groups."""
        self._groups: deque[tuple[int, float, float]] = deque()
        """Middle time, offset and round trip."""
        self._uppers: deque[tuple[int, int]] = deque(maxlen=GROUP)
        self._lowers: deque[tuple[int, int]] = deque(maxlen=GROUP)
        self._count = 0

    def forget_before(self, local_ns: int) -> None:
        """Forget the groups that began before a local time in ns."""
        while self._groups and self._groups[0][0] < local_ns:
            self._groups.popleft()

    def add(self, upper: tuple[int, int], lower: tuple[int, int], skew: float) -> bool:
        """Add the bounds of an answer, the lower with its sign turned; whether a group is complete."""
        if self._uppers and self._uppers[-1][0] < upper[0] - self.window_ns:
            self.clear()
        self._uppers.append(upper)
        self._lowers.append(lower)
        self._count += 1
        if len(self._uppers) < GROUP or self._count % (GROUP // 2):
            return False
        if self._count % GROUP == 0 and self._groups:
            # The last one was of half a group only, and of half the one before; a pause may have taken it.
            self._groups.pop()
        (t0, above) = min(self._uppers, key=lambda bound: bound[1] - skew * (bound[0] - upper[0]))
        (t3, below) = min(self._lowers, key=lambda bound: bound[1] + skew * (bound[0] - upper[0]))
        self._groups.append(((t0 + t3) // 2, (above - below) / 2.0, above + below - skew * (t0 - t3)))
        self.forget_before(upper[0] - self.window_ns)
        return True

    def newest(self) -> list[Newest]:
        """Compare the newest groups with all before them: the last one, the last two, four and so on."""
        if not self._groups:
            return []
        at_ns, level = self._groups[-1][:2]
        points = [(float(t - at_ns), offset - level, gap) for t, offset, gap in self._groups]
        terms = [(t, x, gap, t * t, t * x, x * x) for t, x, gap in points]
        sums = [list(accumulate(column, initial=0.0)) for column in zip(*terms, strict=True)]
        most = len(points)
        return [
            self._compare(sums, count)
            for count in COUNTS
            if count <= most // 2 and most - count >= LEAST_GROUPS
        ]

    def _compare(self, sums: Sequence[Sequence[float]], count: int) -> Newest:
        """Compare the last so many groups with the line through those before.

        `sums` are those of no group, the first, the first two and so on: of times, offsets, round trips,
        squares of times, products, squares of offsets.
        """
        times, offsets, gaps, squares, products, offset_squares = sums
        many = len(times) - 1 - count
        middle, level, gap = times[many] / many, offsets[many] / many, gaps[many] / many
        spread = max(1.0, squares[many] - many * middle**2)
        slope = (products[many] - many * middle * level) / spread
        variance = max(0.0, offset_squares[many] - many * level**2 - slope**2 * spread) / (many - 2)

        intercept = level - slope * middle
        sloped = [offset - slope * time for offset, time in zip(offsets, times, strict=True)]
        earlier = list(map(sub, sloped[count : many + 1], sloped))
        ahead = (times[-1] - times[many]) / count - middle
        chance = variance * (1.0 / count + 1.0 / many + ahead**2 / spread)
        return Newest(
            since_ns=self._groups[-count][0],
            moved=(sloped[-1] - sloped[many]) / count - intercept,
            grown=(gaps[-1] - gaps[many]) / count - gap,
            doubt=hypot(sqrt(chance), DRIFT * ahead**2 / 2.0, 2.0 * STAMP_NS),
            least_skew=abs(slope) - SIGMAS * sqrt(variance / spread),
            usual=max(max(earlier) / count - intercept, intercept - min(earlier) / count),
        )
