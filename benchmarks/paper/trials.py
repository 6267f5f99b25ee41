"""Trials: their number, parallel execution on all available cores, and summaries."""

import signal
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from math import nan
from multiprocessing import active_children, get_context
from os import sched_getaffinity
from typing import TypeVar

T = TypeVar("T")
FEW = 8
"""Number of short calls below which no other processes are started."""


def call_all(calls: Sequence[Callable[[], T]], *, jobs: int | None = None, few: int = FEW) -> list[T]:
    """Return the results of all calls, in order; calls and results must be picklable.

    `jobs` is the number of processes, None for one per core; fewer than `few` calls stay in this one. Ctrl-C
    ends them all at once.
    """
    processes = len(sched_getaffinity(0)) if jobs is None else jobs
    if processes < 2 or len(calls) < few:
        return [call() for call in calls]
    others = set(active_children())
    # Only this process handles Ctrl-C.
    with ProcessPoolExecutor(
        processes, get_context("spawn"), signal.signal, (signal.SIGINT, signal.SIG_IGN)
    ) as pool:
        size = max(1, len(calls) // (4 * processes))
        # Not pool.map: when interrupted, it cancels pending calls, on which a pool without workers fails.
        parts = [pool.submit(_call_each, calls[k : k + size]) for k in range(0, len(calls), size)]
        try:
            return [result for part in parts for result in part.result()]
        except BaseException:
            # The pool itself would wait for running calls.
            for worker in set(active_children()) - others:
                worker.kill()
            raise


def _call_each(calls: Sequence[Callable[[], T]]) -> list[T]:
    return [call() for call in calls]


def share_of(trials: int, share: float, *, least: int = 2) -> int:
    """Return this fraction of the trials as a count, at least `least`."""
    return max(min(least, trials), round(share * trials))


def quantile(ascending: Sequence[float], share: float) -> float:
    """Return the value below which this fraction of the values is; nan for none."""
    return ascending[min(len(ascending) - 1, int(share * len(ascending)))] if ascending else nan
