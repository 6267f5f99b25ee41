"""A set of instants stored as runs, so that its size hardly grows with the length of a recording."""

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Set
from typing import Any


class InstantSet(Set[int]):
    """A set of instants from 0 on; consecutive instants need almost no memory."""

    def __init__(self, instants: Iterable[int] = ()) -> None:
        self._starts: list[int] = []
        self._ends: list[int] = []
        """The end (exclusive) of each run."""
        for instant in sorted(instants):
            self.add(instant)

    def __contains__(self, instant: Any) -> bool:
        """Return whether an instant is in the set."""
        run = bisect_right(self._starts, instant) - 1
        return run >= 0 and instant < self._ends[run]

    def __iter__(self) -> Iterator[int]:
        """Yield the instants in order."""
        for start, end in zip(self._starts, self._ends, strict=True):
            yield from range(start, end)

    def __len__(self) -> int:
        """Return the number of instants."""
        return sum(self._ends) - sum(self._starts)

    @property
    def end(self) -> int:
        """The last instant plus 1; 0 for an empty set."""
        return self._ends[-1] if self._ends else 0

    def add(self, instant: int) -> None:
        """Add an instant."""
        if instant in self:
            return
        run = bisect_right(self._starts, instant)
        self._starts.insert(run, instant)
        self._ends.insert(run, instant + 1)
        # Merge a run with the previous one if they touch.
        for later in (run + 1, run):
            if 0 < later < len(self._starts) and self._starts[later] == self._ends[later - 1]:
                del self._starts[later], self._ends[later - 1]
