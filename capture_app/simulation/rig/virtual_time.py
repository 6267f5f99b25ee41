"""Virtual time: what is to happen is done in the order of its true time, and nothing waits."""

import heapq
from collections.abc import Callable
from typing import Any


class VirtualTime:
    """The true time of a simulation, and all that is scheduled in it.

    Minutes pass in moments, and the same seed gives the same run: what falls on one instant happens in the
    order in which it was scheduled.
    """

    def __init__(self) -> None:
        self.now_true_ns = 0
        self._queue: list[tuple[int, int, Callable[..., object], tuple[Any, ...]]] = []
        self._scheduled = 0

    def schedule(self, true_ns: int, action: Callable[..., object], *arguments: Any) -> None:
        """Let `action(*arguments)` happen at a true time in ns."""
        self._scheduled += 1
        heapq.heappush(self._queue, (true_ns, self._scheduled, action, arguments))

    def run_until(self, end_true_ns: int, done: Callable[[], bool] | None = None) -> bool:
        """Let time pass until then, or until `done()` after an action; return whether that came true."""
        queue, pop = self._queue, heapq.heappop
        while queue and queue[0][0] <= end_true_ns:
            self.now_true_ns, _, action, arguments = pop(queue)
            action(*arguments)
            if done is not None and done():
                return True
        self.now_true_ns = end_true_ns
        return done is not None and done()


class Timer:
    """The one timer of an engine: set anew, it passes over what it was set to before."""

    __slots__ = ("_action", "_arguments", "_due_true_ns", "_time")

    def __init__(self, time: VirtualTime, action: Callable[..., object], *arguments: Any) -> None:
        """`action(*arguments)` happens when it is due."""
        self._time, self._action, self._arguments = time, action, arguments
        self._due_true_ns = -1

    @property
    def is_pending(self) -> bool:
        """Whether it is set to a time to come."""
        return self._due_true_ns > self._time.now_true_ns

    def set(self, true_ns: int) -> None:
        """Be due at a true time in ns, the coming nanosecond at the earliest."""
        true_ns = max(true_ns, self._time.now_true_ns + 1)
        if true_ns != self._due_true_ns:
            self._due_true_ns = true_ns
            self._time.schedule(true_ns, self._ring, true_ns)

    def _ring(self, true_ns: int) -> None:
        if true_ns == self._due_true_ns:
            self._action(*self._arguments)
