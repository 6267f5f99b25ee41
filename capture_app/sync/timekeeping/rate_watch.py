"""Notices on a node that its clock and the leader's do not run at rates that two crystals have."""

from capture_app.sync.clock.clock_filter import RateChange
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.timekeeping.clock_events import ClockRateChanged, ClockRateUnusual, ClockRateUsual

USUAL_PPM = 100.0
"""Two ordinary crystals differ by less."""
STILL_UNUSUAL_PPM = 80.0
"""A rate that was called unusual is called so until it is below this."""
RECENT_NS = 30_000_000_000
"""For so long a change of the rate is spoken of: as long as the clock's samples of before it count."""


class RateWatch:
    """Judges a node's clock against the leader's; `now_ns` is the node's own clock."""

    def __init__(self) -> None:
        self.fast_ppm: float | None = None
        """By how much this node's clock runs faster than the leader's, where that is unusual."""
        self.host_slewing_ppm: float | None = None
        """By how much this node's host makes its clock run faster than usual, as the host says itself."""
        self._changed_ns: int | None = None

    def restart(self) -> None:
        """Judge anew: there is another leader, or a clock has stepped."""
        self.fast_ppm = None

    def judge(
        self, time_map: TimeMap, change: RateChange | None
    ) -> ClockRateUnusual | ClockRateUsual | ClockRateChanged | None:
        """Take in the newest estimate and the latest change that was noticed; return what is news."""
        # The map is from this clock to the leader's: where its skew is positive, the leader's is faster.
        fast_ppm, doubt_ppm = -time_map.skew * 1e6, time_map.skew_uncertainty * 1e6
        least_ppm = USUAL_PPM + doubt_ppm if self.fast_ppm is None else STILL_UNUSUAL_PPM
        before, self.fast_ppm = self.fast_ppm, fast_ppm if abs(fast_ppm) > least_ppm else None
        if change is not None and change.local_ns != self._changed_ns:
            self._changed_ns = change.local_ns
            return ClockRateChanged()
        if (before is None) is (self.fast_ppm is None):
            return None
        return ClockRateUsual() if self.fast_ppm is None else ClockRateUnusual(self.fast_ppm)

    def changed_lately(self, now_ns: int) -> bool:
        """Whether the rate of one of the two clocks has changed a short while ago."""
        return self._changed_ns is not None and now_ns - self._changed_ns < RECENT_NS
