"""One piece of a batch: done whole or not at all, by one process at a time, and never twice.

Light to import: a worker chooses its cores before it loads anything that would start threads.
"""

import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from capture_app.errors import DiskFullError, ExitCode, SimulshotError
from capture_app.session.files.output_folder import OutputFolder, clear_leftovers

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
"""Makes a unit's files in an empty folder; the same bytes whenever it is called."""


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
        return Outcome(key=unit.key, problem=_line(str(error)), code=ExitCode.FAILURE)
    except MemoryError:
        problem = "not enough memory; use fewer --jobs"
        return Outcome(key=unit.key, problem=problem, code=ExitCode.FAILURE)
    except Exception as error:  # noqa: BLE001  (whatever native code throws)
        problem = _line(f"{type(error).__name__}: {error}")
        return Outcome(key=unit.key, problem=problem, code=ExitCode.FAILURE)
    return Outcome(key=unit.key, seconds=time.monotonic() - began, made=made)


def _perform(make: str, unit: Unit, root: Path) -> bool:
    # Only a whole unit is there by its name, and it is never replaced.
    with OutputFolder(root / unit.folder, lambda _: None, wait=True) as output:
        if is_done(unit, root):
            output.discard()
            return False
        _need_room(root, ROOM_TO_BEGIN)
        find_make(make)(unit, output.folder)
        _need_room(root, ROOM_TO_END)
    return True


def tidy(root: Path) -> None:
    """Remove what killed processes left half-made, but for what is still being worked on."""
    for folder in (root / UNITS).glob("*"):
        clear_leftovers(folder)


def _need_room(root: Path, least: int) -> None:
    if shutil.disk_usage(root).free < least:
        raise DiskFullError(f"the disk of {root} is full", hint="make room, then repeat the command")


def _line(text: str) -> str:
    return " ".join(text.split())
