"""A run that replaces a result and is killed again and again; prints what each kill left as a line of JSON.

    -m tests.unit.session.writing.killed_output ROOT EVERY EVERY_IN_NEXT

Kills a run at every so many steps, and for each of these the next run likewise (0: not at all), with a file
system that can exchange folders and with one that cannot.
"""

import logging
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from capture_app.common import system
from capture_app.session.files import output_folder
from capture_app.session.files.output_folder import OutputFolder, replaces_only
from tests.unit.session.writing.killed_writer import REAL, die_at, run, tell

NAME = "out"
EARLIER = {"result": b"earlier", "pictures/1": b"earlier"}
MADE = {"result": b"new", "pictures/2": b"new"}


def write(folder: Path, files: dict[str, bytes]) -> None:
    for name, data in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        if not (folder / name).exists():
            (folder / name).write_bytes(data)


def files(folder: Path) -> dict[str, bytes] | None:
    if not folder.exists():
        return None
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def make(root: Path, pipe: int) -> None:
    """Replace the result, tell when it is done, and tell every warning."""
    warnings = logging.Handler()
    warnings.emit = lambda record: REAL["write"](pipe, b"w")  # type: ignore[method-assign]
    logging.getLogger(output_folder.__name__).addHandler(warnings)
    with OutputFolder(root / NAME, replaces_only(("result", "pictures"))) as output:
        write(output.folder, MADE)
    REAL["write"](pipe, b"d")


def killed_at(step: int, root: Path, exchanges: bool) -> Callable[[int], None]:
    def work(pipe: int) -> None:
        if not exchanges:
            system.exchange = lambda path, other: False
        die_at(step, [(system, "exchange")])
        make(root, pipe)

    return work


def judge(root: Path, earlier: dict[str, bytes] | None, told: bytes) -> list[str]:
    """What is wrong with what a run left."""
    there, hidden = files(root / NAME), root / f".{NAME}.part"
    allowed = [MADE] if b"d" in told else [earlier, MADE]
    if there is None:
        there = files(hidden / "earlier")
    wrong = [] if there in allowed else [f"{there} is neither the earlier nor the new result"]
    if b"d" in told and hidden.exists():
        wrong.append("left something hidden after its end")
    return wrong


def mend(root: Path, exchanges: bool) -> list[str]:
    """The run after the kill: it must succeed, and warn of what it found."""
    hidden = root / f".{NAME}.part"
    found = (hidden / "new").exists() or (hidden / "earlier").exists()
    status, told = run(killed_at(1_000_000, root, exchanges))
    wrong = judge(root, None, told) if b"d" in told else [f"the next run ended with {status}"]
    if found != (b"w" in told):
        wrong.append("what was left was not mentioned" if found else "warned of nothing")
    return wrong


def begin(root: Path, earlier: dict[str, bytes] | None) -> None:
    shutil.rmtree(root, ignore_errors=True)
    root.mkdir(parents=True)
    if earlier is not None:
        write(root / NAME, earlier)


def kill(root: Path, every: int, every_in_next: int, earlier: Any, exchanges: bool) -> Iterator[Any]:
    for step in range(1, 10_000, every):
        for next_step in range(1, 10_000, every_in_next or 10_000):
            begin(root, earlier)
            status, told = run(killed_at(step, root, exchanges))
            wrong = judge(root, earlier, told)
            ended = 0
            if every_in_next and status:
                ended, told = run(killed_at(next_step, root, exchanges))
                wrong += judge(root, earlier, told)
            wrong += mend(root, exchanges)
            tell([step, next_step], {"ended": status, "next": ended, "wrong": wrong})
            if not ended:
                break
        if not status:
            break
        yield


if __name__ == "__main__":
    every, every_in_next = map(int, sys.argv[2:])
    REAL["fsync"] = lambda handle: None  # a step to be killed at; what it costs is not at stake
    for earlier in (EARLIER, None):
        for exchanges in (True, False):
            for _ in kill(Path(sys.argv[1]) / "root", every, every_in_next, earlier, exchanges):
                pass
