"""Priority of a thread. None is lowered: waiting for its turn it would keep the interpreter's lock."""

import os
import threading
from contextlib import suppress


def raise_priority() -> None:
    """Raise the calling thread's priority, and that of threads that it begins, if the system permits it."""
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), -10)
