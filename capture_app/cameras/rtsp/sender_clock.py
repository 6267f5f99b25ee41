"""When an IP camera's frames were, by its sender reports or by what arrives first."""

from collections.abc import Sequence
from statistics import mean

from capture_app.cameras.arrival_clock import ArrivalClock

_LATEST_NS, _CHANGE_NS = 2_000_000_000, 200_000_000
_EARLIEST_NS = 5_000_000
"""No frame of which a report tells the truth comes before it was, nor so much later; nor does that change."""
_HALF = 1 << 31
_S = 1_000_000_000


class SenderClock:
    """Puts a stream's RTP timestamps into the host's monotonic clock; media times are ns since it began.

    A sender report tells what the stream's clock showed when it was sent, whatever the camera's wall clock
    is. It arrived later by no less than nothing and, where it was quick, no more than the least round trip of
    a question to that camera: in the middle of both it is put. A frame's own arrival is later by what the
    camera takes to encode it and the link to carry it, too, which nothing tells: that is left in its time.
    """

    def __init__(self, ticks_per_s: int, round_trips_ns: Sequence[int]) -> None:
        """`round_trips_ns` grows by how long a question to the camera and its answer took."""
        self._ticks_per_s, self._round_trips_ns = ticks_per_s, round_trips_ns
        self._first: int | None = None
        self._newest = 0
        self._by_frames, self._by_reports = ArrivalClock(), ArrivalClock()
        self._last_frame_ticks: int | None = None
        self.reports = 0
        """How many told the moment of their sending."""
        self._usual_ns: int | None = None
        """From a frame to its quickest arrival, by the reports, once they are followed."""

    def media_ns(self, ticks: int) -> int:
        """The media time of an RTP timestamp near the newest one, which wraps around."""
        if self._first is None:
            self._first = self._newest = ticks
        step = (ticks - self._newest + _HALF) % (2 * _HALF) - _HALF
        self._newest = max(self._newest, self._newest + step)
        return (self._newest + min(step, 0) - self._first) * _S // self._ticks_per_s

    def add_frame(self, ticks: int, arrival_ns: int) -> int:
        """Take in when a frame's first packet came; returns its media time."""
        self._last_frame_ticks = ticks
        media_ns = self.media_ns(ticks)
        self._by_frames.add_arrival(media_ns, arrival_ns)
        return media_ns

    def add_report(self, ticks: int, arrival_ns: int) -> None:
        """Take in what a report tells of the stream's clock, and when it came."""
        # Some cameras repeat the last frame's timestamp, which is not that of the report.
        if ticks != self._last_frame_ticks and self._first is not None:
            self.reports += 1
            if self._round_trips_ns:
                self._by_reports.usual_excess_ns = mean(self._round_trips_ns) - min(self._round_trips_ns)
            self._by_reports.add_arrival(self.media_ns(ticks), arrival_ns)

    def follow_reports(self) -> bool:
        """Go by the reports from now on, where there are some that can be true; whether they are."""
        frames_take_ns = self._frames_take_ns()
        if frames_take_ns is not None and -_EARLIEST_NS <= frames_take_ns <= _LATEST_NS:
            self._usual_ns = frames_take_ns
        return self._usual_ns is not None

    @property
    def contradicts_itself(self) -> bool:
        """Whether reports that are followed tell another time of the frames than before."""
        now_ns = self._frames_take_ns()
        return self._usual_ns is not None and now_ns is not None and abs(now_ns - self._usual_ns) > _CHANGE_NS

    def host_ns(self, media_ns: int) -> int:
        """The host's time of a frame that was taken in."""
        clock = self._by_frames if self._usual_ns is None else self._by_reports
        found_ns = clock.host_ns(media_ns)
        assert found_ns is not None
        return found_ns - (0 if self._usual_ns is None else self._half_trip_ns)

    def uncertainty_ns(self, media_ns: int) -> int:
        """95 % error of it; where no reports are followed, but for the least time that frames take."""
        if self._usual_ns is None:
            # Encoding and link together are hardly ever as quick as they could be.
            return self._by_frames.uncertainty_ns(media_ns) + round(self._by_frames.spread_ns)
        return self._half_trip_ns + self._by_reports.uncertainty_ns(media_ns)

    @property
    def _half_trip_ns(self) -> int:
        return min(self._round_trips_ns, default=0) // 2

    def _frames_take_ns(self) -> int | None:
        newest_ns = 0 if self._first is None else self.media_ns(self._newest)
        by_frames_ns, by_reports_ns = self._by_frames.host_ns(newest_ns), self._by_reports.host_ns(newest_ns)
        if by_frames_ns is None or by_reports_ns is None:
            return None
        return by_frames_ns - by_reports_ns + self._half_trip_ns
