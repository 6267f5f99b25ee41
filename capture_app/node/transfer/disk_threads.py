"""Threads for work that blocks on the disk."""

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import ParamSpec, TypeVar

THREADS = 24

P = ParamSpec("P")
T = TypeVar("T")


class DiskThreads:
    """So many that images of many cameras wait together, and share the cost of the disk's syncs."""

    def __init__(self) -> None:
        self._threads = ThreadPoolExecutor(THREADS, "disk")

    async def call(self, work: Callable[P, T], *arguments: P.args, **options: P.kwargs) -> T:
        """Do work that blocks on the disk, and return or raise what it does."""
        loop = asyncio.get_running_loop()
        return await loop.run_in_executor(self._threads, partial(work, *arguments, **options))
