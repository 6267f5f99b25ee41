"""Threads for work that OpenCV does, one a core."""

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import cv2

MAX_WORKERS = 8
"""Each takes some hundred MB for its sweep."""


@contextmanager
def worker_pool() -> Iterator[ThreadPoolExecutor]:
    """A pool of a thread per core; OpenCV, which each of them calls, then uses none of its own."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        with ThreadPoolExecutor(min(MAX_WORKERS, len(os.sched_getaffinity(0)))) as pool:
            yield pool
    finally:
        cv2.setNumThreads(before)
