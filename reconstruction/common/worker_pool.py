"""Threads for work that OpenCV does, at most one a core."""

import os
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import Context, copy_context

import cv2

from reconstruction.common.memory import memory_budget

MAX_WORKERS = 8
"""Each takes some hundred MB for its sweep."""


SWEEP_BYTES = 400 << 20
"""What a worker's sweep takes at most."""


def worker_count() -> int:
    """A worker for each core, as far as half of the memory budget allows."""
    cores = len(os.sched_getaffinity(0))
    return memory_budget().fit_count(SWEEP_BYTES, min(MAX_WORKERS, cores), share=0.5)


def _adopt(context: Context) -> None:
    """Give this thread the memory budget, the checks and the silence of the one that opened its pool."""
    for variable, value in context.items():
        variable.set(value)


_opencv_lock = threading.Lock()
_opencv_threads: list[int] = []
"""How many threads OpenCV had before each of the pools that are open; the number is the process's."""


@contextmanager
def worker_pool() -> Iterator[ThreadPoolExecutor]:
    """A pool of `worker_count` threads; OpenCV, which each of them calls, then uses none of its own."""
    with _opencv_lock:
        _opencv_threads.append(cv2.getNumThreads())
        cv2.setNumThreads(1)
    pool = ThreadPoolExecutor(worker_count(), initializer=_adopt, initargs=(copy_context(),))
    try:
        yield pool
    except KeyboardInterrupt:
        # What runs is not waited for: `main` ends the process, threads and all.
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    except BaseException:
        pool.shutdown(cancel_futures=True)
        raise
    else:
        pool.shutdown()
    finally:
        with _opencv_lock:
            before = _opencv_threads.pop()
            # The last one sets what the first one found, in whichever order they end.
            if not _opencv_threads:
                cv2.setNumThreads(before)
