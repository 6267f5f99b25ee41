"""When a phone's frames were, by its page's clock: media times are even, but begin anywhere."""

from collections import deque
from dataclasses import dataclass
from statistics import median

from capture_app.phones.wire import FrameTold

BLOCK_US, BLOCKS = 3e6, 10
HELD_FRAMES = 8
"""A stream's first frames wait for so many, whose least delay tells where its media times begin."""
RATE_FRAMES, RATE_SHARE = 20, 0.05
"""How many frames tell whether a browser keeps the rate that it says, to within this share."""
USUAL_RATE = 30.0
LEAST_RATE, MOST_RATE = 1.0, 1000.0


@dataclass(frozen=True, slots=True)
class TimedFrame:
    """A frame with its number in its stream, gaps counted, and its time by the page's clock in us."""

    id: int
    stream: int
    sequence: int
    page_us: float


class FrameTimes:
    """Turns what a page tells of its frames into numbered, timed frames, one stream after the other."""

    def __init__(self, rate: float) -> None:
        """`rate` in frames a second is as the browser sets it; 0 where it does not say."""
        self._rate = rate
        self._stream: int | None = None
        self._arrivals: deque[tuple[float, float]] = deque(maxlen=BLOCKS)
        """Begin of a block of time and the least offset in it of the page's clock from the media's, in us."""
        self._held: list[FrameTold] = []
        self._holding = True
        self._sequence, self._last_us = 0, 0.0
        self._steps_us: list[float] = []
        self.period_ns: int | None = None
        """The camera's period, as it keeps it; None while too few frames have come."""

    def add(self, told: FrameTold) -> list[TimedFrame]:
        """Take in a frame; return those that can be told now, none while a stream begins."""
        begins = told.stream != self._stream
        if begins:
            self._stream = told.stream
            self._arrivals.clear()
            self._held, self._holding, self._sequence = [], True, 0
        self._note_arrival(told.media_us, told.capture_us or told.arrived_us)
        if self.period_ns is None:
            self._measure_rate(told, begins)
        if not self._holding:
            return [self._timed(told, first=False)]
        self._held.append(told)
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

    def _measure_rate(self, told: FrameTold, begins: bool) -> None:
        if not begins:
            self._steps_us.append(told.media_us - self._held[-1].media_us)
        if len(self._steps_us) >= RATE_FRAMES:
            step_us = median(self._steps_us)
            rate = self._rate or USUAL_RATE
            if step_us <= 0 or abs(step_us * rate / 1e6 - 1) > RATE_SHARE:
                rate = round(1e6 / max(step_us, 1e6 / MOST_RATE)) if step_us > 0 else rate
            self.period_ns = round(1e9 / min(max(rate, LEAST_RATE), MOST_RATE))

    def _timed(self, told: FrameTold, *, first: bool) -> TimedFrame:
        assert self.period_ns is not None
        if not first:
            self._sequence += max(1, round((told.media_us - self._last_us) * 1000 / self.period_ns))
        self._last_us = told.media_us
        # The least delay of the last half minute, when all went quickly, tells where media times begin; how
        # long camera and phone took until then is not known here, and is part of the bias of the stamps.
        offset_us = min(offset_us for _, offset_us in self._arrivals)
        return TimedFrame(told.id, told.stream, self._sequence, told.media_us + offset_us)
