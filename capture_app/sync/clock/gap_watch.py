"""Change detection by a line's minimum round-trip delay: a stepped or slewed clock.

A line over the samples of two clocks has a smaller gap between the directions than the link allows: the
clock's change moves the bounds of one direction up and those of the other one down. Load, or an attacker who
delays messages, makes no gap smaller.
"""

from collections import deque
from math import inf
from statistics import median

WATCHED_S = 60
"""Time over which a link's usual gap is known, in s; a minute has some twenty of WiFi's spells."""
ALARM, SIGMAS = 0.2, 3.0
"""A gap smaller than usual by this fraction, and by so many sigma of the line's own, is that of two clocks.

Without a change, no gap in ten minutes a link was smaller by more than 0.17 on recorded WiFi, 0.14 on the
paper's link, and 0.05 on a wire and with bufferbloat (simulated). In two hours, 12 minutes on each of ten
links, there was no alarm (docs/accuracy-measurements.md).
"""
SETTLED = 0.05
"""A gap smaller than usual by no more than this is that of one clock, after an alarm."""
_S = 1_000_000_000


class GapWatch:
    """Usual gap of a link's lines: a fraction of the minimum round-trip delay of any one exchange."""

    def __init__(self) -> None:
        self._fastest: deque[tuple[int, int]] = deque()
        """Second and minimum round-trip delay in ns of the last minute; later ones are larger."""
        self._fractions: deque[float] = deque(maxlen=WATCHED_S)
        self._second = 0
        self.least_ns = inf
        """Smallest usual gap ever, in ns: the path's delay before any increase."""

    def add(self, local_ns: int, round_trip_ns: int) -> None:
        """Add an exchange that ended at a local time, in ns."""
        second, fastest = local_ns // _S, self._fastest
        while fastest and fastest[-1][1] >= round_trip_ns:
            fastest.pop()
        fastest.append((second, round_trip_ns))
        while fastest[0][0] <= second - WATCHED_S:
            fastest.popleft()

    def missing(self, gap_ns: float) -> float:
        """Return by which fraction of the usual gap this one is smaller; 0 while that is unknown."""
        return 1.0 - gap_ns / self.usual_ns if self.usual_ns > 0.0 else 0.0

    def is_of_two_clocks(self, gap_ns: float, sigma_ns: float, local_ns: int) -> bool:
        """Return whether the gap of a line until this local time raises an alarm; record it if not."""
        missing = self.missing(gap_ns)
        if missing > ALARM and missing * self.usual_ns > SIGMAS * sigma_ns:
            return True
        if local_ns // _S != self._second and self._fastest[0][1] > 0:
            self._second = local_ns // _S
            self._fractions.append(gap_ns / self._fastest[0][1])
            self.least_ns = min(self.least_ns, self.usual_ns or inf)
        return False

    @property
    def usual_ns(self) -> float:
        """Usual gap in ns of the minute's fastest exchanges; 0 while unknown."""
        if len(self._fractions) < 2:
            return 0.0
        return median(self._fractions) * self._fastest[0][1]
