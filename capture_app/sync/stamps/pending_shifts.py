"""Moves of the phase that were commanded, and which of them are in effect at a frame."""

from bisect import bisect_right
from collections import deque
from statistics import median

LATENCY_FRAMES = (2, 13)
"""A command takes effect so many frames after the newest one, at the earliest and at the latest."""
USUAL_LATENCY_FRAMES = 4
REMEMBERED_LATENCIES = 15
REMEMBERED_FRAMES = 20_000
"""Of so many frames it is known what was in effect: those that a ring buffer may hold."""


class PendingShifts:
    """Shifts of the phase that are in effect, and those still to come; times in ns, frames by their index."""

    def __init__(self) -> None:
        self.done_ns = 0
        self._waiting: deque[tuple[int, int]] = deque()
        self._latencies: deque[int] = deque([USUAL_LATENCY_FRAMES], maxlen=REMEMBERED_LATENCIES)
        self._newest = -LATENCY_FRAMES[1]
        self._felt = 0
        """How many of those waiting the newest frame has shown to be in effect."""
        self._seen: deque[tuple[int, int]] = deque(maxlen=REMEMBERED_FRAMES)
        """Each frame and what was in effect at it, where that is more or less than at the one before."""

    @property
    def latency_frames(self) -> float:
        """Frames from a command until it is in effect, in the middle of those seen."""
        return median(self._latencies)

    @property
    def total_ns(self) -> int:
        """Sum of all shifts, once the last one on its way has arrived."""
        return self.done_ns + sum(shift_ns for _, shift_ns in self._waiting)

    def clear(self) -> None:
        """Forget all: the stream starts anew."""
        self.done_ns = self._felt = 0
        self._newest = -LATENCY_FRAMES[1]
        self._waiting.clear()
        self._seen.clear()

    def expect(self, index: int, shift_ns: int) -> None:
        """A shift was commanded when `index` was the newest frame."""
        self._waiting.append((index, shift_ns))
        self._newest = index

    def all_in_effect(self, index: int) -> bool:
        """Whether each shift so far is in effect for certain at the frame of an index."""
        return index >= self._newest + LATENCY_FRAMES[1]

    def effective_at(self, index: int, seen_ns: float) -> int:
        """Sum of the shifts in effect at a frame that comes `seen_ns` later than without any of them."""
        earliest, latest = LATENCY_FRAMES
        while self._waiting and index >= self._waiting[0][0] + latest:
            self.done_ns += self._waiting.popleft()[1]
            self._felt = max(0, self._felt - 1)
        best_ns = sum_ns = self.done_ns
        felt = 0
        for count, (commanded, shift_ns) in enumerate(self._waiting, 1):
            if index < commanded + earliest:
                break
            sum_ns += shift_ns
            if abs(seen_ns - sum_ns) < abs(seen_ns - best_ns):
                best_ns, felt = sum_ns, count
        if self._waiting and abs(seen_ns - best_ns) < abs(self._waiting[0][1]):
            self._latencies.extend(index - self._waiting[i][0] for i in range(self._felt, felt))
            self._felt = felt
        if not self._seen or self._seen[-1][1] != best_ns:
            self._seen.append((index, best_ns))
        return best_ns

    def seen_at(self, index: int) -> int:
        """Sum of the shifts that were in effect at a frame that has come, as far as it showed."""
        place = bisect_right(self._seen, index, key=lambda change: change[0])
        return self._seen[max(0, place - 1)][1] if self._seen else 0

    def certain_at(self, index: int) -> int:
        """Sum of the shifts that are in effect for certain at the frame of an index: felt, or overdue."""
        return self.done_ns + sum(
            shift_ns
            for count, (commanded, shift_ns) in enumerate(self._waiting)
            if count < self._felt or index >= commanded + LATENCY_FRAMES[1]
        )
