"""Threads for work that OpenCV does, at most one a core."""

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

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


@contextmanager
def worker_pool() -> Iterator[ThreadPoolExecutor]:
    """A pool of `worker_count` threads; OpenCV, which each of them calls, then uses none of its own."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    pool = ThreadPoolExecutor(worker_count())
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
        cv2.setNumThreads(before)
