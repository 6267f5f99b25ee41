"""The terminal UI in a pseudo-terminal: its keys, the bytes it draws, the processor time it takes."""

import fcntl
import os
import pty
import signal
import struct
import sys
import termios
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Self

SIZE = (120, 40)
TICKS_PER_S = os.sysconf("SC_CLK_TCK")


class ScreenProcess:
    """`capture-app` with options, in a terminal of 120x40 that counts what is drawn and throws it away."""

    def __init__(self, *options: str, environment: Mapping[str, str]) -> None:
        self.drawn_bytes = 0
        self._pid, self._terminal = pty.fork()
        if self._pid == 0:
            fcntl.ioctl(0, termios.TIOCSWINSZ, struct.pack("HHHH", SIZE[1], SIZE[0], 0, 0))
            known = {"TERM": "xterm-256color", "COLORTERM": "truecolor"}
            command = [sys.executable, "-m", "capture_app.cli", *options]
            os.execve(sys.executable, command, {**os.environ, **environment, **known})  # noqa: S606
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        os.kill(self._pid, signal.SIGKILL)
        os.waitpid(self._pid, 0)
        self._reader.join()
        os.close(self._terminal)

    def press(self, keys: str) -> None:
        """Type keys."""
        os.write(self._terminal, keys.encode())

    def wait_until_drawn(self, patience_s: float = 60.0) -> None:
        """Wait until it has drawn a first screen. Raises TimeoutError."""
        until_s = time.monotonic() + patience_s
        while self.drawn_bytes < 4 * sum(SIZE):
            if time.monotonic() > until_s:
                raise TimeoutError("the screen has drawn nothing")
            time.sleep(0.1)

    def processor_s(self) -> float:
        """Processor time that it has taken so far, in s."""
        return processor_s(self._pid)

    def _read(self) -> None:
        while True:
            try:
                drawn = os.read(self._terminal, 1 << 16)
            except OSError:
                return
            if not drawn:
                return
            self.drawn_bytes += len(drawn)


def processor_s(pid: int) -> float:
    """Processor time that a process has taken so far, in s; 0 where there is none."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / TICKS_PER_S
