"""What the screen needs of a rig, and the rig behind it: a leader in this process.

Simulated nodes and comparisons are its children.
"""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from capture_app.demo import SimulatedNodes, compare, unused_folder
from capture_app.errors import BadInputError, IncompleteError
from capture_app.node.leader.leader import LeaderNode
from capture_app.node.leader.wording import News, news_line
from capture_app.node.wire.status import BurstStatus, RigStatus
from capture_app.text import ProgressStep


@dataclass(frozen=True, slots=True)
class Comparison:
    """A finished comparison: its verdict in words, and the report's file."""

    verdict: str
    report: Path


class Rig(Protocol):
    """A leader and its cameras, as the screen knows them; errors are SimulshotErrors."""

    def status(self) -> RigStatus:
        """Return the whole rig at this moment."""

    def on_news(self, tell: Callable[[str], None]) -> None:
        """Set who is told, in a line each, what happens."""

    async def burst(self, frames: int) -> BurstStatus:
        """Take a burst of that many instants and return when it is on disk."""

    async def add_simulated(self, cameras: int) -> None:
        """Start that many simulated cameras on this machine."""

    def compare(self, session: Path) -> AsyncIterator[ProgressStep | Comparison]:
        """Compare synchronized with offset frames; the last thing it yields is the Comparison."""


class LiveRig:
    """Runs a leader; `async with` binds its port before the screen opens, and puts all away after."""

    def __init__(self, *, sessions: Path, host: str, port: int) -> None:
        self._leader = LeaderNode(sessions=sessions, host=host, port=port, on_news=self._pass_on_news)
        self._tell: Callable[[str], None] = lambda _: None
        self._last_line = ""
        self._simulated: SimulatedNodes | None = None
        self._open = AsyncExitStack()

    async def __aenter__(self) -> "LiveRig":
        await self._open.enter_async_context(self._leader)
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._open.aclose()

    def status(self) -> RigStatus:
        """Return the whole rig at this moment."""
        return self._leader.status()

    def on_news(self, tell: Callable[[str], None]) -> None:
        """Set who is told, in a line each, what happens."""
        self._tell = tell

    async def burst(self, frames: int) -> BurstStatus:
        """Take a burst and return when it is on disk. Raises SimulshotError."""
        ordered = await self._leader.trigger(frames=frames)
        saved = await self._leader.wait_until_saved(ordered.burst)
        if saved.session is None:
            raise IncompleteError(saved.message or f"burst {saved.burst} gave no session")
        return saved

    async def add_simulated(self, cameras: int) -> None:
        """Start simulated cameras on this machine, once. Raises BadInputError where they run already."""
        if self._simulated is not None:
            raise BadInputError("the simulated cameras are running already")
        self._simulated = SimulatedNodes(self._leader.address, cameras)
        await self._open.enter_async_context(self._simulated)

    async def compare(self, session: Path) -> AsyncIterator[ProgressStep | Comparison]:
        """Run `reconstruct compare` as a child; yield its progress, and at last what it found."""
        out = unused_folder(session.parent, f"{session.name}-compare")
        steps: asyncio.Queue[ProgressStep | None] = asyncio.Queue()

        def on_line(line: str) -> None:
            if step := ProgressStep.parse(line):
                steps.put_nowait(step)

        child = asyncio.create_task(compare(session, out, on_line))
        child.add_done_callback(lambda _: steps.put_nowait(None))
        try:
            while (step := await steps.get()) is not None:
                yield step
            metrics = await child
        finally:
            child.cancel()
        yield Comparison(str(metrics["verdict"]), out / "report.html")

    def _pass_on_news(self, news: News) -> None:
        if isinstance(news, BurstStatus) and not news.done:
            return  # the burst's progress is in every snapshot; only its end is news
        if (line := news_line(news)) and line != self._last_line:
            self._last_line = line
            self._tell(line)
