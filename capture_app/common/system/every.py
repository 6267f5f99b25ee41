"""What each system does alike, or lacks without harm; the modules beside this one add to it or replace it."""

import asyncio
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

NO_LIMIT = 1 << 62
"""Bytes or files that stand for "as many as there are"."""
Received = Callable[[bytes, tuple[str, int], int | None, int | None], None]
"""Takes a datagram, the address that sent it, and its receipt in ns: by the wall clock or by `monotonic_ns`.

The system has stamped it by one of the two clocks, or by none.
"""


@contextmanager
def on_interrupt(interrupt: Callable[[], object]) -> Iterator[None]:
    """Call `interrupt` in the running loop for each Ctrl-C within the block."""
    loop = asyncio.get_running_loop()
    before = signal.signal(signal.SIGINT, lambda *_: loop.call_soon_threadsafe(interrupt))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def end_as_interrupt() -> None:
    """Let a request to end this process raise KeyboardInterrupt, as Ctrl-C does, so that it cleans up."""
    signal.signal(getattr(signal, "SIGBREAK", signal.SIGTERM), signal.default_int_handler)


def usable_cores() -> list[int]:
    """Return the numbers of the processor cores that this process may use."""
    return sorted(getattr(os, "sched_getaffinity", lambda _: range(os.cpu_count() or 1))(0))


def use_cores(cores: Sequence[int]) -> None:
    """Run this thread, and all that it starts, on these cores only, where the system can do that."""
    getattr(os, "sched_setaffinity", lambda *_: None)(0, cores)
