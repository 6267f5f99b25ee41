"""Bounds on the clock offset, by second of local time: only those that can still constrain it are kept."""

from bisect import insort

from capture_app.sync.clock.feasible_lines import lower_hull

BLOCK_NS = 1_000_000_000
RUNNERS_UP = 24
"""Tightest bounds kept per direction: their spacing shows how near the minimum delay they are."""
SETTLED_POINTS = 12

Bound = tuple[int, int]
"""Local time and bound, both in ns; bounds from below are kept with their sign turned."""


class OneWayBounds:
    """The bounds of one direction in one block: those near the tightest, and the next tightest ones."""

    __slots__ = ("_newest_ns", "_steepest", "points", "tightest")

    def __init__(self, steepest: float) -> None:
        self._steepest = steepest
        self._newest_ns = -(2**63)
        """The latest that was ever among the tightest: what comes after it is no duplicate."""
        self.points: list[Bound] = []
        self.tightest: list[tuple[float, Bound]] = []

    def add(self, t_ns: int, value_ns: int, skew: float) -> None:
        """Keep a bound if it can matter; `skew`, as known so far, ranks the runners-up."""
        steepest = self._steepest
        # A bound is superfluous if no clock could drift fast enough to get past another one to it.
        for t, value in self.points:
            if value + steepest * abs(t_ns - t) <= value_ns:
                break
        else:
            self.points = [(t, v) for t, v in self.points if value_ns + steepest * abs(t_ns - t) > v]
            # In front, where it is the first to get in the way of those to come.
            self.points.insert(0, (t_ns, value_ns))
        tightest, level = self.tightest, value_ns - skew * (t_ns % BLOCK_NS)
        full = len(tightest) >= RUNNERS_UP
        if not full or level < tightest[-1][0]:
            bound = (t_ns, value_ns)
            if t_ns <= self._newest_ns and bound in [known for _, known in tightest]:
                return  # a duplicate would look like a second delay near the minimum
            self._newest_ns = max(self._newest_ns, t_ns)
            insort(tightest, (level, bound))
            if full:
                tightest.pop()

    def settle(self) -> None:
        """Keep only the bounds that a straight line can touch: on a steady link nearly all are in the way.

        What a clock bends within a second is nanoseconds, and leaving bounds out never makes one too tight.
        """
        if len(self.points) > SETTLED_POINTS:
            self.points = lower_hull(self.points)


class Block:
    """One second of samples."""

    __slots__ = ("lower", "round_trip_ns", "upper")

    def __init__(self, steepest: float) -> None:
        self.upper = OneWayBounds(steepest)
        self.lower = OneWayBounds(steepest)
        self.round_trip_ns: int | None = None
        """The least, in ns."""

    def settle(self) -> None:
        """Keep only bounds that can still matter, once the second is over."""
        self.upper.settle()
        self.lower.settle()
