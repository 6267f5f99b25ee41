"""Child processes: started, read from, and always terminated."""

import asyncio
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Self, TypeVar

import msgspec

from capture_app.common import system
from capture_app.common.errors import (
    BadInputError,
    CameraError,
    ExitCode,
    IncompleteError,
    NetworkError,
    NotAvailableError,
    SimulshotError,
)
from capture_app.common.text import UNREADABLE, Talk
from capture_app.common.timeouts import CHILD_STOP_TIMEOUT_S

_KINDS: dict[int | None, type[SimulshotError]] = {
    kind.exit_code: kind
    for kind in (BadInputError, CameraError, NetworkError, NotAvailableError, IncompleteError)
}

T = TypeVar("T")
LOWEST_PRIORITY = 19


@dataclass(slots=True)
class Child:
    """Child process in a process group of its own, with its last lines on stderr."""

    name: str
    process: asyncio.subprocess.Process
    on_line: Talk | None = None
    said: deque[str] = field(default_factory=lambda: deque(maxlen=20))
    spoken: asyncio.Event = field(default_factory=asyncio.Event)
    """Set once it has printed a line about itself, `NAME: ...`."""
    listening: asyncio.Task[None] = field(init=False)

    def __post_init__(self) -> None:
        self.listening = asyncio.create_task(self._listen())

    @classmethod
    async def start(
        cls,
        name: str,
        arguments: Sequence[str],
        *,
        variables: Mapping[str, str] | None = None,
        on_line: Talk | None = None,
        niceness: int = 0,
    ) -> Self:
        """Start a module of this installation, with further environment `variables`.

        With a `niceness`: run in the background, at that priority, killed when this process ends, even by
        SIGKILL, and cleaning up when it is stopped. Other modules implement that themselves, as nodes do.
        """
        if niceness:
            arguments = ("capture_app.common.background", str(niceness), *arguments)
        process = await asyncio.create_subprocess_exec(
            *system.PYTHON,
            "-m",
            *arguments,
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            **system.child_options(variables or {}),
        )
        return cls(name, process, on_line)

    async def _listen(self) -> None:
        assert self.process.stderr is not None
        async for raw in self.process.stderr:
            line = raw.decode(errors="replace").rstrip()
            self.said.append(line)
            if line.startswith(f"{self.name}: "):
                self.spoken.set()
            if self.on_line is not None:
                self.on_line(line)

    async def failure(self) -> SimulshotError:
        """Return the error of a process that ended unexpectedly: its own last line."""
        await asyncio.wait((self.listening,), timeout=1.0)
        last = next((line for line in reversed(self.said) if line), "it printed nothing")
        code = self.process.returncode
        if code is not None and code < 0 and last.startswith(f"{self.name}: "):
            last = "it was killed"  # what it logged before, perhaps long ago, is not the reason
        last = (last.partition(": error: ")[2] or last).removeprefix(f"{self.name}: ")
        return error_of_exit(code, f"{self.name} ended with code {code}: {last}")

    async def output(self) -> bytes:
        """Return its stdout once it has ended. Raises the process's own error if it failed."""
        assert self.process.stdout is not None
        printed = await self.process.stdout.read()
        if await self.process.wait():
            raise await self.failure()
        return printed

    def pause(self) -> None:
        """Suspend the process and all its children until `resume`."""
        self._signal("pause")

    def resume(self) -> None:
        """Resume the process and its children after `pause`."""
        self._signal("resume")

    def _signal(self, what: str) -> None:
        with suppress(ProcessLookupError):
            if self.process.returncode is None:
                system.signal_group(self.process.pid, what)

    async def stop(self, timeout_s: float = CHILD_STOP_TIMEOUT_S) -> bool:
        """Ask the process and all its children to end, and kill what does not; return whether it did."""
        self._signal("end")
        try:
            async with asyncio.timeout(timeout_s):
                await self.process.wait()
        except TimeoutError:
            return False
        finally:
            self._signal("kill")
            await self.process.wait()
            self.listening.cancel()
        return True


async def ask_reconstruct(
    arguments: Sequence[str], kind: type[T], *, on_line: Talk | None = None, niceness: int = 0
) -> T:
    """Run `reconstruct` in a process of its own, and return what it prints with --json.

    Raises the error that it ends with, such as NotAvailableError where it is not installed.
    """
    name = f"reconstruct {arguments[0]}"
    child = await Child.start(
        name, ("reconstruction.cli", *arguments, "--json"), on_line=on_line, niceness=niceness
    )
    try:
        return msgspec.json.decode(await child.output(), type=kind)
    except UNREADABLE as error:
        raise SimulshotError(
            f"the output of {name} is unreadable: {error}", hint="reinstall simulshot"
        ) from error
    finally:
        await child.stop()


def error_of_exit(code: int | None, what: str) -> SimulshotError:
    """Return the error of a child command with that exit code, which the error keeps."""
    error = _KINDS.get(code, SimulshotError)(what)
    if code in tuple(ExitCode):
        error.exit_code = ExitCode(code)
    return error
