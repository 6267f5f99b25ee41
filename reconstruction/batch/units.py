"""One piece of a batch: done whole or not at all, by one process at a time, and never twice.

Light to import: a worker chooses its cores before it loads anything that would start threads.
"""

import errno
import fcntl
import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from capture_app.errors import DiskFullError, ExitCode, SimulshotError
from capture_app.session.files.durable import sync_folder

UNITS = "units"
WORK = "work"
ROOM_TO_BEGIN = 64 << 20
ROOM_TO_END = 1 << 20
"""Bytes that must still be free: native code that ran out of room leaves half a file and says nothing."""


@dataclass(frozen=True, kw_only=True)
class Unit:
    """One instant of a session in one condition; `key` is a checksum of all that its result depends on."""

    session: str
    """Its folder, absolute."""
    name: str
    instant: int
    condition: str
    key: str
    offsets_ms: tuple[float, ...] = ()
    """How much later each camera's image is, in the session's order; none: all of the instant."""
    matcher: str = "sweep"

    @property
    def label(self) -> str:
        """Its name in a progress line."""
        return f"{self.name}, instant {self.instant}, {self.condition}"

    @property
    def folder(self) -> str:
        """Where its result lies, relative to the batch's folder."""
        return f"{UNITS}/{self.name}/{self.instant:04d}-{self.condition}-{self.key[:16]}"


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """How a unit went; `problem` says why there is no result."""

    key: str
    seconds: float = 0.0
    made: bool = False
    """False: the result was there already."""
    problem: str = ""
    code: int = ExitCode.OK


Make = Callable[[Unit, Path], None]
"""Makes a unit's files in a folder that is not there yet; the same bytes whenever it is called."""


def find_make(name: str) -> Make:
    """The function of `module:function`; by name, as other processes and machines look it up too."""
    module, _, function = name.partition(":")
    found: Make = getattr(import_module(module), function)
    return found


def is_done(unit: Unit, root: Path) -> bool:
    """Whether its result is there: a folder with that name is whole."""
    return (root / unit.folder).is_dir()


def perform(make: str, unit: Unit, root: Path) -> Outcome:
    """Make a unit's folder in the batch's folder, unless it is there; waits for whoever is at it already.

    Raises nothing: a unit that fails must not take the others along.
    """
    began = time.monotonic()
    try:
        made = _perform(make, unit, root)
    except SimulshotError as error:
        return Outcome(key=unit.key, problem=_line(str(error)), code=error.exit_code)
    except OSError as error:
        return Outcome(key=unit.key, problem=_line(_disk(error)), code=ExitCode.FAILURE)
    except MemoryError:
        problem = "not enough memory; use fewer --jobs"
        return Outcome(key=unit.key, problem=problem, code=ExitCode.FAILURE)
    except Exception as error:  # noqa: BLE001  (whatever native code throws)
        problem = _line(f"{type(error).__name__}: {error}")
        return Outcome(key=unit.key, problem=problem, code=ExitCode.FAILURE)
    return Outcome(key=unit.key, seconds=time.monotonic() - began, made=made)


def _perform(make: str, unit: Unit, root: Path) -> bool:
    target, place = root / unit.folder, root / WORK / unit.key
    place.parent.mkdir(parents=True, exist_ok=True)
    with _locked(place.with_suffix(".lock")):
        if is_done(unit, root):
            return False
        # Somebody was killed here.
        shutil.rmtree(place, ignore_errors=True)
        try:
            _need_room(root, ROOM_TO_BEGIN)
            place.mkdir()
            find_make(make)(unit, place / "result")
            _need_room(root, ROOM_TO_END)
            _settle(place / "result")
            target.parent.mkdir(parents=True, exist_ok=True)
            (place / "result").rename(target)
            sync_folder(target.parent)
        finally:
            shutil.rmtree(place, ignore_errors=True)
    return True


def tidy(root: Path) -> None:
    """Remove what killed processes left half-made, but for what is still being worked on."""
    for place in (root / WORK).iterdir():
        lock = place.with_suffix(".lock")
        if place.is_dir() and lock.exists():
            with suppress(BlockingIOError), _locked(lock, fcntl.LOCK_NB):
                shutil.rmtree(place, ignore_errors=True)


@contextmanager
def _locked(path: Path, how: int = 0) -> Iterator[None]:
    """Hold a file's lock, which the system takes back from a process that is killed."""
    with path.open("ab") as file:
        fcntl.flock(file, fcntl.LOCK_EX | how)
        yield


def _need_room(root: Path, least: int) -> None:
    if shutil.disk_usage(root).free < least:
        raise DiskFullError(f"the disk of {root} is full", hint="make room, then repeat the command")


def _settle(folder: Path) -> None:
    """Make a folder and all that is in it survive a power cut."""
    for path in sorted(folder.rglob("*"), reverse=True):
        if path.is_dir():
            sync_folder(path)
        else:
            with path.open("rb") as file:
                os.fsync(file.fileno())
    sync_folder(folder)


def _disk(error: OSError) -> str:
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return "the disk is full (make room, then repeat the command)"
    return str(error)


def _line(text: str) -> str:
    return " ".join(text.split())
