"""Tasks beside the one that began them, how they are ended, and waits that are not for ever."""

import asyncio
from collections.abc import Coroutine
from contextlib import suppress
from typing import Any


async def end(*tasks: "asyncio.Future[Any]") -> list[Any]:
    """Cancel tasks, wait until all are over, and return what each returned or raised."""
    for task in tasks:
        task.cancel()
    return await asyncio.gather(*tasks, return_exceptions=True)


async def first_of(*work: Coroutine[Any, Any, Any]) -> "list[asyncio.Task[Any]]":
    """Do all of it side by side until one is over, end the others, and return all of them."""
    tasks = [asyncio.create_task(one) for one in work]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        await end(*tasks)
    return tasks


async def has_come(event: asyncio.Event, within_s: float) -> bool:
    """Wait for an event, at most so long; return whether it is there."""
    with suppress(TimeoutError):
        async with asyncio.timeout(within_s):
            await event.wait()
    return event.is_set()


class Background:
    """Tasks that nobody waits for, which are kept while they run."""

    def __init__(self) -> None:
        self._running: set[asyncio.Task[Any]] = set()

    def start(self, work: Coroutine[Any, Any, Any]) -> None:
        """Begin some work."""
        task = asyncio.create_task(work)
        self._running.add(task)
        task.add_done_callback(self._running.discard)

    async def end(self) -> None:
        """End all that runs."""
        await end(*self._running)
