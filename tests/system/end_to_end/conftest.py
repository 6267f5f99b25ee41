"""Real processes on this machine's loopback network, started as a user would start them."""

import asyncio
import json
import os
import sys
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from tests.waiting import SLOW_PATIENCE_S, time_limit

TIMEOUT_S = SLOW_PATIENCE_S
"""Only what hangs takes so long: a busy machine is slow, and nothing here judges how fast it is."""


class Command:
    """A running `capture-app ...`, and what it has said on stderr so far."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self.process = process
        self.said: list[str] = []
        self._event_log = asyncio.Condition()
        self._reading = asyncio.create_task(self._read())

    async def says(self, text: str, *, after: int = 0) -> str:
        """Wait for a line with that text, the `after`-th of all lines or later, and return it."""
        async with time_limit(lambda: f"{text!r}; it has said {self.said}", TIMEOUT_S), self._event_log:
            while True:
                for line in self.said[after:]:
                    if text in line:
                        return line
                if self._reading.done():
                    raise AssertionError(f"it ended without {text!r}: {self.said}")
                await self._event_log.wait()

    async def next_json(self) -> dict[str, Any]:
        """Return the next line of stdout."""
        assert self.process.stdout is not None
        async with time_limit(lambda: f"a line of JSON; it has said {self.said}", TIMEOUT_S):
            line: dict[str, Any] = json.loads(await self.process.stdout.readline())
            return line

    async def next_event(self, kind: str) -> dict[str, Any]:
        """Return the next line of stdout that tells of such an event."""
        while (told := await self.next_json())["event"] != kind:
            pass
        return told

    async def finish(self) -> str:
        """Wait for its end and return what it printed on stdout."""
        assert self.process.stdout is not None
        async with time_limit(lambda: f"its end; it has said {self.said}", TIMEOUT_S):
            printed = await self.process.stdout.read()
            await self.process.wait()
            await self._reading
        return printed.decode()

    async def kill(self) -> None:
        """End it the hard way, as a power cut would."""
        self.process.kill()
        await self.process.wait()

    async def stop(self) -> int:
        """Ask it to end, reading what it still prints, and return its exit code."""
        with suppress(ProcessLookupError):
            self.process.terminate()
        await self.finish()
        return await self.process.wait()

    async def evict(self) -> None:
        """Leave nothing running."""
        with suppress(ProcessLookupError):
            self.process.kill()
        await self.finish()

    async def _read(self) -> None:
        assert self.process.stderr is not None
        async for raw in self.process.stderr:
            async with self._event_log:
                self.said.append(raw.decode().rstrip())
                self._event_log.notify_all()
        async with self._event_log:
            self._event_log.notify_all()


Start = Callable[..., Awaitable[Command]]


@pytest.fixture
async def start(tmp_path: Path) -> AsyncIterator[Start]:
    """Start `capture-app` with arguments; everything is killed when the test ends."""
    running: list[Command] = []

    async def start_command(*arguments: str) -> Command:
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "capture_app.cli",
            *arguments,
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            env={**os.environ, "PYTHONUNBUFFERED": "1", "XDG_STATE_HOME": str(tmp_path / "state")},
        )
        command = Command(process)
        running.append(command)
        return command

    yield start_command
    await asyncio.gather(*(command.evict() for command in running))
