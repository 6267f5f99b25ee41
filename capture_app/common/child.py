"""Processes of our own: started, listened to, and never left behind."""

import asyncio
import os
import signal
import sys
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Self

from capture_app.common.errors import (
    BadInputError,
    CameraError,
    ExitCode,
    IncompleteError,
    NetworkError,
    NotAvailableError,
    SimulshotError,
)
from capture_app.common.timeouts import CHILD_STOP_TIMEOUT_S

Talk = Callable[[str], None]
_KINDS: dict[int | None, type[SimulshotError]] = {
    kind.exit_code: kind
    for kind in (BadInputError, CameraError, NetworkError, NotAvailableError, IncompleteError)
}


@dataclass(slots=True)
class Child:
    """A process of ours, in a group of its own, and the last it said on stderr."""

    name: str
    process: asyncio.subprocess.Process
    on_line: Talk | None = None
    said: deque[str] = field(default_factory=lambda: deque(maxlen=20))
    spoken: asyncio.Event = field(default_factory=asyncio.Event)
    """Set when it has said something."""
    listening: asyncio.Task[None] = field(init=False)

    def __post_init__(self) -> None:
        self.listening = asyncio.create_task(self._listen())

    @classmethod
    async def start(
        cls, name: str, arguments: Sequence[str], *, on_line: Talk | None = None, background: bool = False
    ) -> Self:
        """Start a module of this installation.

        `background`: at the lowest priority, ended with us even if we are killed, and cleaning up after
        itself when it is stopped; other modules must see to that themselves, as nodes do.
        """
        if background:
            arguments = ("capture_app.common.background", *arguments)
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            *arguments,
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            start_new_session=True,
        )
        return cls(name, process, on_line)

    async def _listen(self) -> None:
        assert self.process.stderr is not None
        async for raw in self.process.stderr:
            line = raw.decode(errors="replace").rstrip()
            self.said.append(line)
            self.spoken.set()
            if self.on_line is not None:
                self.on_line(line)

    async def failure(self) -> SimulshotError:
        """The error of a process that has ended when it should not have: its own last words."""
        await asyncio.wait((self.listening,), timeout=1.0)
        last = next((line for line in reversed(self.said) if line), "it said nothing")
        last = (last.partition(": error: ")[2] or last).removeprefix(f"{self.name}: ")
        code = self.process.returncode
        return error_of_exit(code, f"{self.name} ended with code {code}: {last}")

    async def output(self) -> bytes:
        """What it prints on stdout until it has ended. Raises its own error where that is a failure."""
        assert self.process.stdout is not None
        printed = await self.process.stdout.read()
        if await self.process.wait():
            raise await self.failure()
        return printed

    def pause(self) -> None:
        """Let the process and all that it started stand still until `resume`."""
        self._signal(signal.SIGSTOP)

    def resume(self) -> None:
        """Let it go on."""
        self._signal(signal.SIGCONT)

    def _signal(self, kind: signal.Signals) -> None:
        with suppress(ProcessLookupError):
            if self.process.returncode is None:
                os.killpg(self.process.pid, kind)

    async def stop(self) -> None:
        """End the process and all that it started: kindly first, then at once."""
        for kind in (signal.SIGTERM, signal.SIGKILL):
            try:
                os.killpg(self.process.pid, kind)
                os.killpg(self.process.pid, signal.SIGCONT)
                async with asyncio.timeout(CHILD_STOP_TIMEOUT_S):
                    await self.process.wait()
            except ProcessLookupError:
                break
            except TimeoutError:
                continue
            break
        await self.process.wait()
        self.listening.cancel()


def error_of_exit(code: int | None, what: str) -> SimulshotError:
    """The error of a command of ours that has ended with that code, which it keeps."""
    error = _KINDS.get(code, SimulshotError)(what)
    if code in tuple(ExitCode):
        error.exit_code = ExitCode(code)
    return error
