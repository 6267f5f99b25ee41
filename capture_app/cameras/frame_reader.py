"""Thread that takes frames out of a driver's few buffers in time, whatever the event loop does meanwhile."""

import asyncio
import threading
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Generic, TypeVar

from capture_app.common import system

F = TypeVar("F")
INTERVAL_NS, BUFFERED_FRACTION = 50_000_000, 0.25
"""Interval of the reads, each dearer than the frames that it takes; its maximum as a fraction
of the time that the driver's buffers last."""
BUDGET_NS = 4_000_000_000
"""Time for which frames wait for the event loop; then they are left to the driver, which drops some."""


class FrameReader(Generic[F]):
    """Reader of one stream, from its creation to `stop`; the event loop gets its frames in batches."""

    def __init__(
        self,
        read: Callable[[], Iterable[F]],
        deliver: Callable[[F], None],
        fail: Callable[[OSError], None],
        *,
        period_ns: int,
        buffers: int,
    ) -> None:
        """`read` returns what the driver has, in a thread; `deliver` and `fail` are called on the event loop.

        `fail` gets the OSError of a `read`, which is the last one.
        """
        self._read, self._deliver, self._fail = read, deliver, fail
        self._interval_s = min(INTERVAL_NS, BUFFERED_FRACTION * buffers * period_ns) / 1e9
        self._max_waiting = max(2, BUDGET_NS // period_ns)
        self._waiting: deque[F] = deque()
        self._stopped = threading.Event()
        self._loop = asyncio.get_running_loop()
        self._thread = threading.Thread(target=self._run, name="frames", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Deliver nothing more."""
        self._stopped.set()

    def join(self) -> None:
        """Wait until nothing is read any more. Blocks for one read."""
        self._thread.join()

    def _run(self) -> None:
        system.raise_thread_priority()
        error = None
        while error is None and not self._stopped.wait(self._interval_s):
            if len(self._waiting) < self._max_waiting:
                try:
                    self._waiting.extend(self._read())
                except OSError as raised:
                    error = raised
            if self._waiting or error:
                # The loop may be closed, when the process ends.
                with suppress(RuntimeError):
                    self._loop.call_soon_threadsafe(self._hand_over, error)

    def _hand_over(self, error: OSError | None) -> None:
        while self._waiting and not self._stopped.is_set():
            self._deliver(self._waiting.popleft())
        if error is not None and not self._stopped.is_set():
            self._fail(error)
