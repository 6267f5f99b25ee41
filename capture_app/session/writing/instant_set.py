"""A set of instants that hardly grows with a recording: it keeps where runs of them begin and end."""

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Set


class InstantSet(Set[int]):
    """Instants from 0 on; cheap where they follow each other."""

    def __init__(self, instants: Iterable[int] = ()) -> None:
        self._starts: list[int] = []
        self._ends: list[int] = []
        """The first instant after each run."""
        self._length = 0
        for instant in sorted(instants):
            self.add(instant)

    def __contains__(self, instant: object) -> bool:
        """Whether an instant is in it."""
        if not isinstance(instant, int):
            return False
        run = bisect_right(self._starts, instant) - 1
        return run >= 0 and instant < self._ends[run]

    def __iter__(self) -> Iterator[int]:
        """Yield the instants in their order."""
        for start, end in zip(self._starts, self._ends, strict=True):
            yield from range(start, end)

    def __len__(self) -> int:
        """Return how many they are."""
        return self._length

    @property
    def end(self) -> int:
        """The instant after the last one; 0 of an empty set."""
        return self._ends[-1] if self._ends else 0

    def add(self, instant: int) -> None:
        """Add one."""
        if instant in self:
            return
        self._length += 1
        run = bisect_right(self._starts, instant)
        self._starts.insert(run, instant)
        self._ends.insert(run, instant + 1)
        # A run that begins where the one before it ends is one with that.
        for later in (run + 1, run):
            if 0 < later < len(self._starts) and self._starts[later] == self._ends[later - 1]:
                del self._starts[later], self._ends[later - 1]
