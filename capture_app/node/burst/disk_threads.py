"""The threads of a leader that wait for its disk."""

import asyncio
import functools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import ParamSpec, TypeVar

DISK_THREADS = 8

P = ParamSpec("P")
T = TypeVar("T")


class DiskThreads:
    """One pool for all bursts of a leader; its threads end with `close`."""

    def __init__(self) -> None:
        self._threads = ThreadPoolExecutor(DISK_THREADS, "disk")

    async def call(self, work: Callable[P, T], *arguments: P.args, **options: P.kwargs) -> T:
        """Do work that blocks on the disk, and return or raise what it does."""
        loop = asyncio.get_running_loop()
        return await loop.run_in_executor(self._threads, functools.partial(work, *arguments, **options))

    def close(self) -> None:
        """Take on no more work, and end when what was begun is done."""
        self._threads.shutdown(wait=False)
