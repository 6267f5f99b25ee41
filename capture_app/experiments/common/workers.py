"""Independent trials on all cores that this process may use."""

from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from os import sched_getaffinity
from typing import TypeVar

T = TypeVar("T")
FEW = 8
"""Fewer short calls are not worth the start of other processes."""


def call_all(calls: Sequence[Callable[[], T]], *, jobs: int | None = None, few: int = FEW) -> list[T]:
    """Return what each call returns, in their order; calls and results can be pickled.

    `jobs` is the number of processes, None for one per core; fewer than `few` calls stay in this one.
    """
    processes = len(sched_getaffinity(0)) if jobs is None else jobs
    if processes < 2 or len(calls) < few:
        return [call() for call in calls]
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        chunk = max(1, len(calls) // (4 * processes))
        return list(pool.map(_call, calls, chunksize=chunk))


def _call(call: Callable[[], T]) -> T:
    return call()
