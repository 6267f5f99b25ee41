"""Thread pool for OpenCV work, with at most one thread per core."""

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import Context, copy_context
from functools import lru_cache, wraps
from typing import ParamSpec, TypeVar, cast

import cv2

from capture_app.common import system
from reconstruction.common.memory import memory_budget

P = ParamSpec("P")
Result = TypeVar("Result")


SWEEP_BYTES = 400 << 20
"""Maximum memory of one worker's sweep."""


def max_workers(bytes_each: float = SWEEP_BYTES) -> int:
    """Return the workers that half of the memory budget holds, on any machine: results depend on it."""
    return memory_budget().fit_count(bytes_each, 8, fraction=0.5)


def worker_count(bytes_each: float = SWEEP_BYTES) -> int:
    """Return one worker per core, at most `max_workers`."""
    return min(max_workers(bytes_each), len(system.usable_cores()))


def _adopt(context: Context) -> None:
    """Give this thread the context (memory budget, checks, silence) of the one that opened the pool."""
    for variable, value in context.items():
        variable.set(value)


def computed_once(make: Callable[P, Result], max_cached: int | None = None) -> Callable[P, Result]:
    """Return a cached function; threads that ask for the same result at a time compute it once."""
    cached = cast("Callable[P, Result]", lru_cache(max_cached)(make))
    locks: dict[object, threading.Lock] = {}

    @wraps(make)
    def get(*args: P.args, **kwargs: P.kwargs) -> Result:
        with locks.setdefault((args, *kwargs.items()), threading.Lock()):
            return cached(*args, **kwargs)

    return get


_opencv_lock = threading.Lock()
_opencv_threads: list[int] = []
"""OpenCV's process-wide number of threads before each of the open pools."""


@contextmanager
def worker_pool(threads: int = 0) -> Iterator[ThreadPoolExecutor]:
    """Open a pool of threads, by default `worker_count`; OpenCV uses no threads of its own meanwhile."""
    with _opencv_lock:
        _opencv_threads.append(cv2.getNumThreads())
        cv2.setNumThreads(1)
    pool = ThreadPoolExecutor(threads or worker_count(), initializer=_adopt, initargs=(copy_context(),))
    try:
        yield pool
    except BaseException as error:
        # On Ctrl-C do not wait for running work: `main` ends the process with its threads.
        pool.shutdown(wait=not isinstance(error, KeyboardInterrupt), cancel_futures=True)
        raise
    else:
        pool.shutdown()
    finally:
        with _opencv_lock:
            before = _opencv_threads.pop()
            # The last pool to end restores what the first one found, in any order.
            if not _opencv_threads:
                cv2.setNumThreads(before)
