"""Waiting for what threads, other processes and files do."""

import asyncio
from collections.abc import Callable

PATIENCE_S = 400.0
"""Of each wait, which ends as soon as what it waits for is there: a starved machine may take its time."""


async def until(holds: Callable[[], object]) -> None:
    """Wait until something is true that no event tells."""
    async with asyncio.timeout(PATIENCE_S):
        while not holds():  # noqa: ASYNC110
            await asyncio.sleep(0.02)
