"""Small shifts of a stream that were commanded, while nobody knows yet from which frame on they count.

A device obeys some frames after a command. Each frame in between is judged by itself: it has felt as many of
the waiting shifts, in their order, as explain its time best.
"""

from collections import deque

LATENCY_FRAMES = (2, 9)
"""A command counts at the earliest and at the latest for the frame that comes so many after the newest."""


class PendingShifts:
    """The sum of the shifts that count, and those on their way; times in ns, frames by their index."""

    def __init__(self) -> None:
        self.done_ns = 0
        self._waiting: deque[tuple[int, int]] = deque()

    @property
    def total_ns(self) -> int:
        """Sum of all shifts, once the last one on its way has arrived."""
        return self.done_ns + sum(shift_ns for _, shift_ns in self._waiting)

    def clear(self) -> None:
        """Forget all: the stream starts anew."""
        self.done_ns = 0
        self._waiting.clear()

    def expect(self, index: int, shift_ns: int) -> None:
        """A shift was commanded when `index` was the newest frame."""
        self._waiting.append((index, shift_ns))

    def felt_by(self, index: int, seen_ns: float) -> int:
        """Sum of the shifts that a frame has felt which comes `seen_ns` later than without any of them."""
        earliest, latest = LATENCY_FRAMES
        while self._waiting and index >= self._waiting[0][0] + latest:
            self.done_ns += self._waiting.popleft()[1]
        best_ns = sum_ns = self.done_ns
        for commanded, shift_ns in self._waiting:
            if index < commanded + earliest:
                break
            sum_ns += shift_ns
            if abs(seen_ns - sum_ns) < abs(seen_ns - best_ns):
                best_ns = sum_ns
        return best_ns

    def due_by(self, index: int) -> int:
        """Sum of the shifts that the frame of a future index will have felt for certain."""
        due = (shift_ns for commanded, shift_ns in self._waiting if index >= commanded + LATENCY_FRAMES[1])
        return self.done_ns + sum(due)
