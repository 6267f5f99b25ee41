"""A real terminal (tmux) that a test types into and reads."""

import asyncio
import os
import shlex
import shutil
import signal
import subprocess
import sys
import uuid
from collections.abc import Mapping
from pathlib import Path
from typing import Self

import pytest

from tests.system.end_to_end.conftest import TIMEOUT_S

LOOK_EVERY_S = 0.2


def require_tmux() -> None:
    """Skip the test where there is no tmux."""
    if shutil.which("tmux") is None:
        pytest.skip("there is no tmux here")


class Terminal:
    """`capture-app` in a terminal of its own; `async with` starts it, and kills what is left of it."""

    def __init__(
        self, *arguments: str, environment: Mapping[str, str], folder: Path, size: tuple[int, int] = (120, 40)
    ) -> None:
        settings = {"TERM": "xterm-256color", "COLORTERM": "truecolor", "PYTHONPATH": str(Path.cwd())}
        # Of these two the screen would believe the tests' own terminal rather than this one.
        words = ["env", "-u", "COLUMNS", "-u", "LINES"]
        words += [*(f"{name}={value}" for name, value in {**settings, **environment}.items())]
        words += [sys.executable, "-m", "capture_app.cli", *arguments]
        self._size = size
        self._server = f"simulshot-{uuid.uuid4().hex[:12]}"
        # tmux loses the exit code now and then: the terminal closes, and the process is never waited for.
        self._code = folder / f".{self._server}"
        self._command = f"cd {shlex.quote(str(folder))} && {shlex.join(words)}; echo $? >{self._code.name}"

    async def __aenter__(self) -> Self:
        columns, lines = map(str, self._size)
        # Its last screen and exit code stay to be read.
        keep = (";", "set-option", "-g", "remain-on-exit", "on", ";", "set-option", "-g", "status", "off")
        new = ("new-session", "-d", "-x", columns, "-y", lines, "sleep 600")
        self._tmux("-f", "/dev/null", *new, *keep)
        self._tmux("resize-window", "-x", columns, "-y", lines)
        self._tmux("respawn-pane", "-k", self._command)
        return self

    async def __aexit__(self, *_: object) -> None:
        self._tmux("kill-server")

    @property
    def screen(self) -> str:
        """What it shows now; spaces that do not break are plain here."""
        return self._tmux("capture-pane", "-p").replace("\u00a0", " ").replace("\u202f", " ")

    @property
    def pid(self) -> int:
        """The process of the screen."""
        shell = self._tmux("display-message", "-p", "#{pane_pid}").strip()
        return int(Path(f"/proc/{shell}/task/{shell}/children").read_text().split()[0])

    def press(self, *keys: str) -> None:
        """Press keys, by the names that tmux has for them."""
        self._tmux("send-keys", *keys)

    async def shows(self, *texts: str) -> str:
        """Wait until all these texts are on the screen, and return it."""
        screen = ""
        try:
            async with asyncio.timeout(TIMEOUT_S):
                while True:
                    screen = self.screen
                    if all(text in screen for text in texts):
                        return screen
                    await asyncio.sleep(LOOK_EVERY_S)
        except TimeoutError:
            raise AssertionError(f"{texts} did not all come; the screen is\n{screen}") from None

    async def ends(self) -> int:
        """Wait until the screen is closed, and return its exit code, over 128 where a signal ended it."""
        try:
            async with asyncio.timeout(TIMEOUT_S):
                while True:
                    if self._code.exists() and (code := self._code.read_text().strip()):
                        return int(code)
                    await asyncio.sleep(LOOK_EVERY_S)
        except TimeoutError:
            raise AssertionError(f"the screen did not close; it is\n{self.screen}") from None

    def kill(self) -> None:
        """End the screen the hard way."""
        os.kill(self.pid, signal.SIGKILL)

    def _tmux(self, *arguments: str) -> str:
        done = subprocess.run(
            ["tmux", "-L", self._server, *arguments], capture_output=True, text=True, check=True
        )
        return done.stdout
