"""Waiting for what threads, other processes and files do."""

import asyncio
import inspect
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

TIMEOUT_S = 30.0
"""What a wait takes at most that ends as soon as what it waits for is there, on a busy machine, too."""
SLOW_PATIENCE_S = 120.0
"""What a rig may take, on a busy machine, until its clocks are known and its cameras are in step."""


def looked_at(condition: Callable[[], object]) -> Callable[[], str]:
    """Tell a condition's code, and what it looks at, as it is when asked."""

    def tell() -> str:
        if not inspect.isroutine(condition) or inspect.isbuiltin(condition):
            return repr(condition)
        names = inspect.getclosurevars(condition).nonlocals
        return inspect.getsource(condition).strip() + "".join(f"\n  {n} = {v!r}" for n, v in names.items())

    return tell


@asynccontextmanager
async def time_limit(awaited: str | Callable[[], str], seconds: float = TIMEOUT_S) -> AsyncIterator[None]:
    """Let a block take so long at most; what did not come is named by the failure."""
    try:
        async with asyncio.timeout(seconds):
            yield
    except TimeoutError as error:
        what = awaited if isinstance(awaited, str) else awaited()
        raise AssertionError(f"waited {seconds:g} s for {what}") from error


async def until(condition: Callable[[], object], *, seconds: float = TIMEOUT_S) -> None:
    """Wait until something is true that no event tells."""
    async with time_limit(looked_at(condition), seconds):
        while not condition():  # noqa: ASYNC110
            await asyncio.sleep(0.02)
