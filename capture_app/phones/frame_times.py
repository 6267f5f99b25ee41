"""Times of a phone's frames in its page's clock: media times are even, but their zero is arbitrary."""

from collections import deque
from dataclasses import dataclass
from statistics import median

from capture_app.phones.wire import FrameReport

BLOCK_US, BLOCKS = 3e6, 10
HELD_FRAMES = 8
"""Number of first frames held back; their minimum delay locates the zero of the stream's media times."""
RATE_FRAMES, RATE_FRACTION = 20, 0.05
"""Number of frames by which a browser's stated rate is checked, and the relative tolerance."""
TYPICAL_RATE = 30.0
MIN_RATE, MAX_RATE = 1.0, 1000.0


@dataclass(frozen=True, slots=True)
class TimedFrame:
    """A frame with its number in its stream, counting gaps, and its time in the page's clock in us."""

    id: int
    stream: int
    sequence: int
    page_us: float


class FrameTimes:
    """Converts a page's frame reports to numbered, timed frames, one stream after another."""

    def __init__(self, rate: float) -> None:
        """Create the converter; `rate` in frames/s is the browser's setting, 0 if it states none."""
        self._rate = rate
        self._stream: int | None = None
        self._arrivals: deque[tuple[float, float]] = deque(maxlen=BLOCKS)
        """Start of a time block, and its minimum offset of the page's clock from media time, in us."""
        self._held: list[FrameReport] = []
        self._holding = True
        self._sequence, self._last_us = 0, 0.0
        self._steps_us: list[float] = []
        self.period_ns: int | None = None
        """Measured period of the camera; None until enough frames have arrived."""

    def add(self, report: FrameReport) -> list[TimedFrame]:
        """Add a frame; return the frames that can be timed now, none while a stream begins."""
        begins = report.stream != self._stream
        if begins:
            self._stream = report.stream
            self._arrivals.clear()
            self._held, self._holding, self._sequence = [], True, 0
        self._note_arrival(report.media_us, report.capture_us or report.arrived_us)
        if self.period_ns is None:
            self._measure_rate(report, begins)
        if not self._holding:
            return [self._timed(report, first=False)]
        self._held.append(report)
        if self.period_ns is None or len(self._held) < HELD_FRAMES:
            return []
        self._holding = False
        return [self._timed(frame, first=n == 0) for n, frame in enumerate(self._held)]

    def _note_arrival(self, media_us: float, seen_us: float) -> None:
        offset_us = seen_us - media_us
        if not self._arrivals or seen_us - self._arrivals[-1][0] >= BLOCK_US:
            self._arrivals.append((seen_us, offset_us))
        elif offset_us < self._arrivals[-1][1]:
            self._arrivals[-1] = self._arrivals[-1][0], offset_us

    def _measure_rate(self, report: FrameReport, begins: bool) -> None:
        if not begins:
            self._steps_us.append(report.media_us - self._held[-1].media_us)
        if len(self._steps_us) >= RATE_FRAMES:
            step_us = median(self._steps_us)
            rate = self._rate or TYPICAL_RATE
            if step_us <= 0 or abs(step_us * rate / 1e6 - 1) > RATE_FRACTION:
                rate = round(1e6 / max(step_us, 1e6 / MAX_RATE)) if step_us > 0 else rate
            self.period_ns = round(1e9 / min(max(rate, MIN_RATE), MAX_RATE))

    def _timed(self, report: FrameReport, *, first: bool) -> TimedFrame:
        assert self.period_ns is not None
        if not first:
            self._sequence += max(1, round((report.media_us - self._last_us) * 1000 / self.period_ns))
        self._last_us = report.media_us
        # The minimum delay of the last half minute, when everything was fast, locates the media times' zero.
        # The delay of camera and phone before that is not known here, and is part of the bias of the stamps.
        offset_us = min(offset_us for _, offset_us in self._arrivals)
        return TimedFrame(report.id, report.stream, self._sequence, report.media_us + offset_us)
