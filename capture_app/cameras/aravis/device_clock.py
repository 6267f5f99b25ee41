"""Times by a camera's own counter, put into this machine's monotonic clock; all in ns."""

from itertools import pairwise
from typing import Protocol

from capture_app.cameras.base import DeviceClock
from capture_app.sync.clock.clock_filter import ClockFilter, ClockSample
from capture_app.sync.clock.likely_line import lower_hull
from capture_app.sync.clock.priors import MAX_SKEW
from capture_app.sync.clock.time_map import TimeMap

_BLOCK_NS, _BLOCKS = 1_000_000_000, 20
_SET_NS = 1_000_000_000
"""No frame is that much quicker or slower than the one before it."""


class CounterClock(Protocol):
    """The map from a camera's counter to the host's clock."""

    def host_ns(self, counter_ns: int) -> int | None:
        """The host's time of a reading of the counter; None where nothing is known of it yet."""


class LatchedClock:
    """A counter that can be read: each reading falls between the request and its answer.

    The sync engine's clock filter makes a line of them, as of the time messages of two machines.
    """

    def __init__(self) -> None:
        self._filter = ClockFilter()
        self._map: TimeMap | None = None

    def add_reading(self, sent_ns: int, counter_ns: int, answered_ns: int) -> None:
        """Take in what the counter showed between two times of the host."""
        self._filter.add(ClockSample(sent_ns, counter_ns, counter_ns, answered_ns))
        self._map = self._filter.time_map(answered_ns)

    def host_ns(self, counter_ns: int) -> int | None:
        """See `CounterClock.host_ns`."""
        return None if self._map is None else self._map.local_from_leader(counter_ns)

    def uncertainty_ns(self, host_ns: int) -> int:
        """95 % error of a host's time that `host_ns` gave."""
        return 0 if self._map is None else round(self._map.uncertainty_at(host_ns))

    def accuracy(self, now_ns: int) -> DeviceClock | None:
        """How well the counter is known at a time of the host; None before the first reading."""
        if self._map is None:
            return None
        bound_ns = round(self._map.hard_bound_at(now_ns))
        return DeviceClock(uncertainty_ns=self.uncertainty_ns(now_ns), hard_bound_ns=bound_ns)


class EnvelopeClock:
    """A counter that cannot be read: no frame arrives before its stamp, and the quickest tell the line.

    The lower envelope of arrivals over stamps (Moon et al. 1999), so that the host's times are late by the
    least delay from stamp to arrival, whatever that is.
    """

    def __init__(self) -> None:
        self._quickest: dict[int, tuple[int, int]] = {}
        """By second of the counter: the stamp that arrived soonest, and its delay."""
        self._origin_ns = self._delay_ns = self._last_delay_ns = 0
        self._slope = 0.0

    def add_arrival(self, counter_ns: int, arrival_ns: int) -> None:
        """Take in when a frame with that stamp arrived, by the host's clock."""
        block, delay_ns = counter_ns // _BLOCK_NS, arrival_ns - counter_ns
        if abs(delay_ns - self._last_delay_ns) > _SET_NS:
            self._quickest.clear()  # the counter was set
        self._last_delay_ns = delay_ns
        known = self._quickest.get(block)
        if known is not None and known[1] <= delay_ns:
            return
        self._quickest[block] = counter_ns, delay_ns
        for old in sorted(self._quickest)[:-_BLOCKS]:
            del self._quickest[old]
        self._fit()

    def host_ns(self, counter_ns: int) -> int | None:
        """See `CounterClock.host_ns`."""
        if not self._quickest:
            return None
        return counter_ns + self._delay_ns + round(self._slope * (counter_ns - self._origin_ns))

    def _fit(self) -> None:
        """Take the side of the hull below the middle of the stamps: it has the least distance to all."""
        points = list(self._quickest.values())
        self._origin_ns, least_ns = points[0]
        hull = lower_hull((float(at - self._origin_ns), float(delay - least_ns)) for at, delay in points)
        middle = sum(at - self._origin_ns for at, _ in points) / len(points)
        self._slope, level = 0.0, min(value for _, value in hull)
        for (before, low), (after, high) in pairwise(hull):
            slope = (high - low) / (after - before)
            if before <= middle <= after and abs(slope) <= MAX_SKEW:
                self._slope, level = slope, low - slope * before
        self._delay_ns = least_ns + round(level)
