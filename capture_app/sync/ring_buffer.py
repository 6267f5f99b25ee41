"""The newest frames of a stream, kept so that a trigger may lie in the past."""

from collections import deque
from typing import Generic, TypeVar

F = TypeVar("F")


class RingBuffer(Generic[F]):
    """Holds the last `capacity` frames with their timestamps in ns of the local clock."""

    def __init__(self, capacity: int) -> None:
        self._entries: deque[tuple[int, F]] = deque(maxlen=capacity)

    def __len__(self) -> int:
        return len(self._entries)

    def add(self, local_ns: int, frame: F) -> None:
        """Keep a frame; the oldest goes when the buffer is full."""
        self._entries.append((local_ns, frame))

    @property
    def oldest_local_ns(self) -> int | None:
        """Timestamp of the oldest frame, None where there is none."""
        return self._entries[0][0] if self._entries else None

    @property
    def newest_local_ns(self) -> int | None:
        """Timestamp of the newest frame, None where there is none."""
        return self._entries[-1][0] if self._entries else None

    def nearest(self, local_ns: int) -> tuple[int, F] | None:
        """Return the timestamp and the frame nearest to a local time in ns; the earlier one of a tie."""
        return min(self._entries, key=lambda entry: abs(entry[0] - local_ns), default=None)
