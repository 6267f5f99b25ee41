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

from .conftest import PATIENCE_S

LOOK_EVERY_S = 0.2


def require_tmux() -> None:
    """Skip the test where there is no tmux; in CI its absence is a failure."""
    if shutil.which("tmux") is None:
        if os.environ.get("CI"):
            pytest.fail("there is no tmux here")
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
        self._command = f"cd {shlex.quote(str(folder))} && exec {shlex.join(words)}"
        self._size = size
        self._server = f"simulshot-{uuid.uuid4().hex[:12]}"

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
        return int(self._tmux("display-message", "-p", "#{pane_pid}"))

    def press(self, *keys: str) -> None:
        """Press keys, by the names that tmux has for them."""
        self._tmux("send-keys", *keys)

    async def shows(self, *texts: str) -> str:
        """Wait until all these texts are on the screen, and return it."""
        screen = ""
        try:
            async with asyncio.timeout(PATIENCE_S):
                while True:
                    screen = self.screen
                    if all(text in screen for text in texts):
                        return screen
                    await asyncio.sleep(LOOK_EVERY_S)
        except TimeoutError:
            raise AssertionError(f"{texts} did not all come; the screen is\n{screen}") from None

    async def ends(self) -> int:
        """Wait until the screen is closed, and return its exit code, or less the signal that ended it."""
        try:
            async with asyncio.timeout(PATIENCE_S):
                while True:
                    # The terminal may be closed a little before the code is known.
                    code, number = self._tmux(
                        "display-message", "-p", "#{pane_dead_status},#{pane_dead_signal}"
                    ).split(",")
                    if code.strip() or number.strip():
                        return int(code) if code.strip() else -int(number)
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
