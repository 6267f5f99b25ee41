"""Helpers for asyncio: background tasks, cancellation, and waits with a timeout."""

import asyncio
from collections.abc import Coroutine
from contextlib import suppress
from typing import Any, TypeVar

T = TypeVar("T")


async def end(*tasks: "asyncio.Future[Any]") -> list[Any]:
    """Cancel tasks, wait until all have ended, and return the result or the exception of each."""
    for task in tasks:
        task.cancel()
    return await asyncio.gather(*tasks, return_exceptions=True)


async def first_of(*work: Coroutine[Any, Any, T]) -> T:
    """Run coroutines concurrently until one ends, cancel the others, and return its result.

    Raises the error of that one only, unlike a task group.
    """
    tasks = [asyncio.create_task(coroutine) for coroutine in work]
    try:
        ended, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        await end(*tasks)
    return next(task for task in tasks if task in ended).result()


async def has_come(event: asyncio.Event, within_s: float | None) -> bool:
    """Wait up to `within_s` (None: forever) for an event; return whether it is set."""
    with suppress(TimeoutError):
        async with asyncio.timeout(within_s):
            await event.wait()
    return event.is_set()


class Background:
    """Fire-and-forget tasks, referenced while they run so that they are not garbage-collected."""

    def __init__(self) -> None:
        self._running: set[asyncio.Task[Any]] = set()

    def start(self, work: Coroutine[Any, Any, Any]) -> None:
        """Run a coroutine as a background task."""
        task = asyncio.create_task(work)
        self._running.add(task)
        task.add_done_callback(self._running.discard)

    async def end(self) -> None:
        """Cancel all running tasks."""
        await end(*self._running)
