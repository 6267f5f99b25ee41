"""When the frames of a recording were taken, and when they are played: over and over, as from a sensor."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise


@dataclass(frozen=True, slots=True)
class RecordedTiming:
    """When each frame was taken, ascending, in ns since the recording's beginning; it lasts for `loop_ns`."""

    period_ns: int
    loop_ns: int
    at_ns: tuple[int, ...]

    @property
    def slots(self) -> tuple[int, ...]:
        """The camera's frame number of each frame, from 0; a gap is what it dropped."""
        steps = (max(1, round((after - before) / self.period_ns)) for before, after in pairwise(self.at_ns))
        return tuple(accumulate(steps, initial=0))

    @property
    def loop_slots(self) -> int:
        """Frame numbers from the first frame to where it comes again."""
        again_ns = self.loop_ns - (self.at_ns[-1] - self.at_ns[0])
        return self.slots[-1] + max(1, round(again_ns / self.period_ns))


@dataclass(frozen=True, slots=True)
class PlayedFrame:
    """One frame that is played; `start_ns` is when it begins, in ns of the host's monotonic clock."""

    index: int
    """Of the recorded frame."""
    sequence: int
    stream: int
    start_ns: int


class Playback:
    """Plays frames by the times they were recorded with; after the last one the first one comes again."""

    def __init__(self, timing: RecordedTiming, *, anchored: bool = False) -> None:
        """`anchored`: the recording begins whenever a whole number of its loops is over since time 0.

        So several cameras of one recording keep together. Else a stream begins when it is told to start.
        """
        self._timing, self._slots, self._loop_slots = timing, timing.slots, timing.loop_slots
        self._anchored = anchored
        self._turn = self._index = 0
        """Loops that are over, and the next frame of this one."""
        self._base_ns = self._first_slot = 0
        self._stream = -1

    def start(self, at_ns: int) -> None:
        """Begin a stream at that time with the next frame or, anchored, with the one that comes then."""
        timing = self._timing
        self._stream += 1
        if self._anchored:
            self._base_ns = 0
            self._turn = (at_ns - timing.at_ns[0]) // timing.loop_ns
            self._index = 0
            while self._start_ns() < at_ns:
                self._step()
        else:
            self._base_ns = at_ns - self._turn * timing.loop_ns - timing.at_ns[self._index]
        self._first_slot = self._slot()

    def lengthen_frame(self, duration_ns: int) -> None:
        """Let the next frame last so long instead of a period: all after it come so much later."""
        self._base_ns += duration_ns - self._timing.period_ns

    def next_frame(self) -> PlayedFrame:
        """Return the next frame of the stream."""
        frame = PlayedFrame(self._index, self._slot() - self._first_slot, self._stream, self._start_ns())
        self._step()
        return frame

    def _start_ns(self) -> int:
        return self._base_ns + self._turn * self._timing.loop_ns + self._timing.at_ns[self._index]

    def _slot(self) -> int:
        return self._turn * self._loop_slots + self._slots[self._index]

    def _step(self) -> None:
        self._index += 1
        if self._index == len(self._timing.at_ns):
            self._turn, self._index = self._turn + 1, 0


def timing_of_video(times_ns: Sequence[int], period_ns: int) -> RecordedTiming:
    """The timing of frames that came at these ascending times."""
    at_ns = tuple(time - times_ns[0] for time in times_ns)
    return RecordedTiming(period_ns, at_ns[-1] + period_ns, at_ns)
