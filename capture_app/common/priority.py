"""Priorities of this process's threads, on systems that have one for each thread."""

import os
import threading
from contextlib import suppress


def raise_priority() -> None:
    """Raise the calling thread's priority if permitted: drivers drop what is not taken in time."""
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), -10)


def lower_priority() -> None:
    """Lower the calling thread's priority below all others of this process: the clock exchange runs first."""
    # Linux has a niceness per thread; on systems without one, all threads stay equal.
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), 10)
