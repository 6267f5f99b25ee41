"""Time from a key's byte to its effect on the screen, in a raw pseudo-terminal beside five live previews.

The effect is a word that only the answer draws: rows of the plan for an arrow, the words of the help, of the
palette and of an empty list of sessions. `--load N` starts N processes that compute, as saving a take does.
"""

import argparse
import fcntl
import os
import pty
import random
import select
import signal
import statistics
import struct
import subprocess
import sys
import tempfile
import termios
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from benchmarks.report import print_table

PATIENCE_S = 3.0
PLAN = (b"before", b"after", b"countdown", b"mode")
SPIN = "while True: pass"


@dataclass(frozen=True)
class Key:
    """A key, the words that its answer draws, and the key that leads back."""

    what: str
    byte: bytes
    words: tuple[bytes, ...]
    back: bytes = b""
    back_what: str = ""


KEYS = (
    Key("an arrow in the plan", b"\x1b[B", PLAN, b"\x1b[A"),
    Key("help", b"?", (b"Escape", b"esc"), b"\x1b"),
    Key("palette", b"\x10", (b"earch for",), b"\x1b"),
    Key("Sessions", b"3", (b"No session", b"newest first"), b"2", "and back"),
)


class Terminal:
    """The program on a pseudo-terminal, and what it has written since the last key."""

    def __init__(self, command: list[str], columns: int, rows: int, env: dict[str, str]) -> None:
        self.pid, self._terminal = pty.fork()
        if self.pid == 0:
            os.execvpe(command[0], command, env)  # noqa: S606 - a terminal needs no shell
        fcntl.ioctl(self._terminal, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))
        os.kill(self.pid, signal.SIGWINCH)
        self.written = b""

    def press(self, byte: bytes) -> None:
        """Press a key, and forget what was written before."""
        self._read(0.0)
        self.written = b""
        os.write(self._terminal, byte)

    def wait(self, words: tuple[bytes, ...], seconds: float = PATIENCE_S) -> float | None:
        """Return the seconds until one of these words is written; None if it is not."""
        begun = time.perf_counter()
        while time.perf_counter() - begun < seconds:
            self._read(0.002)
            if any(word in self.written for word in words):
                return time.perf_counter() - begun
        return None

    def rest(self, seconds: float) -> None:
        """Read what the program writes for so long."""
        until = time.perf_counter() + seconds
        while time.perf_counter() < until:
            self._read(0.05)

    def cpu_s(self) -> float:
        """Return the processor time of the program itself, in seconds."""
        fields = Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def _read(self, seconds: float) -> None:
        while select.select([self._terminal], [], [], seconds)[0]:
            try:
                self.written += os.read(self._terminal, 1 << 16)
            except OSError:
                return  # it has ended
            seconds = 0.0


@contextmanager
def loaded(processes: int) -> Iterator[None]:
    """Let so many processes compute while the block runs."""
    spinning = [subprocess.Popen([sys.executable, "-c", SPIN]) for _ in range(processes)]
    try:
        yield
    finally:
        for one in spinning:
            one.kill()
            one.wait()


def measured(terminal: Terminal, presses: int, draw: Callable[[float, float], float]) -> list[list[str]]:
    """Return a row for each key: median, 90th percentile and answers that did not come."""
    rows = []
    for key in KEYS:
        answers: dict[str, list[float | None]] = {key.what: []}
        for _ in range(presses):
            terminal.rest(draw(0.3, 0.7))
            terminal.press(key.byte)
            answers[key.what].append(terminal.wait(key.words))
            terminal.rest(draw(0.3, 0.7))
            terminal.press(key.back)
            answers.setdefault(key.back_what or key.what + ", back", []).append(terminal.wait(PLAN))
        for what, seconds in answers.items():
            came = sorted(1000 * one for one in seconds if one is not None)
            spread = (
                [f"{statistics.median(came):.0f}", f"{came[int(0.9 * (len(came) - 1))]:.0f}"]
                if came
                else ["", ""]
            )
            rows.append([what, *spread, str(len(seconds) - len(came))])
    return rows


def main() -> None:
    """Start the program with five simulated cameras, press keys, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--load", type=int, default=0, help="processes that compute meanwhile")
    parser.add_argument("--presses", type=int, default=20, help="presses of each key")
    parser.add_argument("--size", default="120x40", help="columns x rows")
    parser.add_argument("--program", default=str(Path(sys.executable).with_name("capture-app")))
    asked = parser.parse_args()
    columns, rows = map(int, asked.size.split("x"))
    with tempfile.TemporaryDirectory() as folder:
        env = {**os.environ, "HOME": folder, "TERM": "xterm-256color", "COLORTERM": "truecolor"}
        env |= {name: f"{folder}/{name}" for name in ("XDG_DATA_HOME", "XDG_CONFIG_HOME", "XDG_STATE_HOME")}
        os.chdir(folder)
        terminal = Terminal([asked.program], columns, rows, env)
        try:
            if terminal.wait((b"imulated",), 30.0) is None:
                sys.exit("the program does not start: " + terminal.written[-2000:].decode(errors="replace"))
            terminal.rest(1.0)
            terminal.press(b"s")
            if terminal.wait((b"5 cameras ready", b"ready to take"), 60) is None:
                sys.exit("the rig is not ready: " + terminal.written[-3000:].decode(errors="replace"))
            terminal.press(b"2")
            terminal.wait((b"pictures",), 10.0)
            terminal.rest(5.0)
            with loaded(asked.load):
                terminal.rest(2.0)
                cpu, begun = terminal.cpu_s(), time.perf_counter()
                terminal.rest(10.0)
                share = (terminal.cpu_s() - cpu) / (time.perf_counter() - begun)
                lines = measured(terminal, asked.presses, random.Random(1).uniform)
            title = f"{asked.size}, five previews, load {asked.load} (simulated cameras)"
            print(title)
            print_table(["key", "median ms", "90 % ms", "no answer"], lines)
            print(f"\nthe screen at rest takes {100 * share:.1f} % of a core")
        finally:
            terminal.press(b"q")
            terminal.rest(0.5)
            terminal.press(b"s")
            terminal.rest(3.0)
            os.kill(terminal.pid, signal.SIGTERM)


if __name__ == "__main__":
    main()
