"""Host times of an IP camera's frames, from its sender reports or from the earliest arrivals."""

from collections.abc import Sequence
from statistics import mean

from capture_app.cameras.arrival_clock import ArrivalClock

_LATEST_NS, _CHANGE_NS = 2_000_000_000, 200_000_000
_EARLIEST_NS = 5_000_000
"""Reports are credible if frames arrive at most 5 ms early or 2 s late by them, changing by at most 0.2 s."""
_HALF = 1 << 31


class SenderClock:
    """Maps a stream's RTP timestamps to the host's monotonic clock; media times are ns since its beginning.

    A sender report shows the stream's clock at the moment of sending, whatever the camera's wall clock shows.
    Its network delay is at least zero. For a quick report it is at most the minimum round trip of a request
    to that camera. The estimate takes the middle. A frame's own arrival also includes the camera's encoding
    and the link's transmission time. Nothing measures those, so they stay in its time.
    """

    def __init__(self, ticks_per_s: int, round_trips_ns: Sequence[int]) -> None:
        """Create the clock; `round_trips_ns` grows by each round trip of a request to the camera."""
        self._ticks_per_s, self._round_trips_ns = ticks_per_s, round_trips_ns
        self._first: int | None = None
        self._newest = 0
        self._by_frames, self._by_reports = ArrivalClock(), ArrivalClock()
        self._last_frame_ticks: int | None = None
        self.reports = 0
        """Number of reports that carry their moment of sending."""
        self._typical_ns: int | None = None
        """Minimum delay from a frame to its arrival, by the reports; None until reports are followed."""

    def media_ns(self, ticks: int) -> int:
        """Return the media time of an RTP timestamp near the newest one; handles wrap-around."""
        if self._first is None:
            self._first = self._newest = ticks
        step = (ticks - self._newest + _HALF) % (2 * _HALF) - _HALF
        self._newest = max(self._newest, self._newest + step)
        return (self._newest + min(step, 0) - self._first) * 1_000_000_000 // self._ticks_per_s

    def add_frame(self, ticks: int, arrival_ns: int) -> int:
        """Add the arrival of a frame's first packet; return its media time."""
        self._last_frame_ticks = ticks
        media_ns = self.media_ns(ticks)
        self._by_frames.add_arrival(media_ns, arrival_ns)
        return media_ns

    def add_report(self, ticks: int, arrival_ns: int) -> None:
        """Add a report: its reading of the stream's clock, and its arrival."""
        # Some cameras repeat the last frame's timestamp instead of the report's own.
        if ticks != self._last_frame_ticks and self._first is not None:
            self.reports += 1
            if self._round_trips_ns:
                self._by_reports.typical_excess_ns = mean(self._round_trips_ns) - min(self._round_trips_ns)
            self._by_reports.add_arrival(self.media_ns(ticks), arrival_ns)

    def follow_reports(self) -> bool:
        """Use the reports from now on if they are credible; return whether they are."""
        frames_take_ns = self._frames_take_ns()
        if frames_take_ns is not None and -_EARLIEST_NS <= frames_take_ns <= _LATEST_NS:
            self._typical_ns = frames_take_ns
        return self._typical_ns is not None

    @property
    def contradicts_itself(self) -> bool:
        """Whether the reports in use now give the frames a different time than before."""
        now_ns, typical_ns = self._frames_take_ns(), self._typical_ns
        return typical_ns is not None and now_ns is not None and abs(now_ns - typical_ns) > _CHANGE_NS

    def host_ns(self, media_ns: int) -> int:
        """Return the host's time of a frame that was added."""
        clock = self._by_frames if self._typical_ns is None else self._by_reports
        found_ns = clock.host_ns(media_ns)
        assert found_ns is not None
        return found_ns - (0 if self._typical_ns is None else self._half_round_trip_ns)

    def uncertainty_ns(self, media_ns: int) -> int:
        """Return its 95 % error; without reports in use, the frames' minimum delay is left out."""
        if self._typical_ns is None:
            # Encoding and transmission hardly ever both take their minimum time.
            return self._by_frames.uncertainty_ns(media_ns) + round(self._by_frames.jitter_ns)
        return self._half_round_trip_ns + self._by_reports.uncertainty_ns(media_ns)

    @property
    def _half_round_trip_ns(self) -> int:
        return min(self._round_trips_ns, default=0) // 2

    def _frames_take_ns(self) -> int | None:
        newest_ns = 0 if self._first is None else self.media_ns(self._newest)
        by_frames_ns, by_reports_ns = self._by_frames.host_ns(newest_ns), self._by_reports.host_ns(newest_ns)
        if by_frames_ns is None or by_reports_ns is None:
            return None
        return by_frames_ns - by_reports_ns + self._half_round_trip_ns
