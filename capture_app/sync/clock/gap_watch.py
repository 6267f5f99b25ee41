"""Change detection by a line's gap, its minimum round-trip delay: a stepped or slewed clock.

Each clock has a line of its own. A line over the samples of both has a smaller gap than either, as the
change moves the bounds of one direction up and those of the other one down. Load, or an attacker who delays
messages, makes no gap smaller. A path that has become faster makes that of the newest samples smaller, too.
"""

from collections import deque
from enum import Enum, auto
from math import inf
from typing import NamedTuple

from capture_app.sync.clock.likely_line import ASYMMETRY

SIGMAS, WATCHED_NS = 3.0, 30_000_000_000
"""A gap is too small for chance beyond this many sigma, compared with those of this time before.

With a sigma of the asymmetry besides, nothing was detected in 2.8 hours without a change, 12 minutes on each
of 14 links, three of them a recording (simulated; docs/accuracy-measurements.md).
"""
ALERT_SIGMAS = 1.5
"""The same after a change, without the asymmetry: a path rarely changes just when a clock does, and samples
of the slew that are missed bend the line for as long as they are in it."""
QUEUE = 1.5
"""A gap that is so many times the surest one is a queue's that fills just after a change: no measure.

What is lost later on is then nearly all the queue's, and samples of a slew are not found: not ready for over
60 s after 1,500 ppm, or falsely for 24 s (bufferbloat, 200 ms).
"""
RESTORED = 0.5
"""Fraction of the missing gap that the newest samples alone have to have, for a clock to have changed.

All of it after a change, and none of it on a path that has become faster.
"""


class LineGap(NamedTuple):
    """Gap of a line until a local time; all in ns."""

    local_ns: int
    gap: float
    sigma: float
    """One sigma of what more messages of the same clock and path may still take from it."""

    @property
    def least(self) -> float:
        """Smallest gap of later lines of the same clock and path, in ns."""
        return (1.0 - ASYMMETRY) * self.gap - SIGMAS * self.sigma


class Cause(Enum):
    """Why a line's gap is smaller than before."""

    CLOCK = auto()
    PATH = auto()


class GapWatch:
    """Gaps of a link's lines, of which those that are relevant are stored."""

    def __init__(self) -> None:
        self._gaps: deque[tuple[LineGap, float]] = deque()
        """Each is later than the one before, and its `least` is smaller; with the path's gap until then."""
        self.path_ns = inf
        """Smallest gap of the path so far, in ns."""

    def add(self, gap: LineGap, *, is_of_path: bool = True) -> None:
        """Add the gap of the newest line; unless it `is_of_path`, it may be that of two clocks."""
        if is_of_path or self.path_ns == inf:
            self.path_ns = min(self.path_ns, gap.gap)
        elif self._gaps and gap.gap > QUEUE * self._gaps[0][0].gap:
            return
        while self._gaps and self._gaps[-1][0].least <= gap.least:
            self._gaps.pop()
        self._gaps.append((gap, self.path_ns))
        while self._gaps[0][0].local_ns < gap.local_ns - WATCHED_NS:
            self._gaps.popleft()

    def before(self, gap_ns: float, *, is_alert: bool) -> LineGap | None:
        """Return the newest gap that this one falls short of; by less, just after a change (`is_alert`)."""
        gaps = (one for one, _ in reversed(self._gaps))
        limits = ((one, one.gap - ALERT_SIGMAS * one.sigma if is_alert else one.least) for one in gaps)
        return next((one for one, limit_ns in limits if gap_ns < limit_ns), None)

    def forget_before(self, local_ns: int) -> None:
        """Remove the gaps until a local time in ns: the path was slower then."""
        while self._gaps and self._gaps[0][0].local_ns <= local_ns:
            self._gaps.popleft()

    def restart(self, local_ns: int) -> None:
        """Remove all gaps at a local time in ns, as a clock has changed, but the one that is surest.

        The path is still the same: a line with a smaller gap is that of two clocks again.
        """
        if self._gaps:
            surest, self.path_ns = self._gaps[0]
            self._gaps.clear()
            self._gaps.append((surest._replace(local_ns=local_ns), self.path_ns))


def cause_of(before: LineGap, gap_ns: float, newest: LineGap) -> Cause | None:
    """Return why a gap is smaller than the one before, if the newest samples' own gap tells."""
    missing, restored = before.gap - gap_ns, newest.gap - gap_ns
    if restored - newest.sigma > RESTORED * missing:
        return Cause.CLOCK
    return Cause.PATH if restored + newest.sigma < RESTORED * missing else None
