"""One unit of a batch: computed atomically, by one process at a time, and only once.

Imports nothing that starts threads: a worker chooses its cores first.
"""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Self

from capture_app.common import system
from capture_app.common.errors import BadInputError, DiskFullError, ExitCode, SimulshotError
from capture_app.session.files.output_folder import OutputFolder, clear_leftovers

UNITS = "units"
WORK = "work"
RESULT = "unit.json"


@dataclass(frozen=True, kw_only=True)
class Unit:
    """One instant of a session in one condition; `key` is a checksum of all that its result depends on."""

    session: str
    """Absolute path of the session's folder."""
    name: str
    instant: int
    condition: str
    key: str = ""
    offsets_ms: tuple[float, ...] = ()
    """Delay of each camera's image, in the session's order; empty if all are of the instant."""
    matcher: str = "sweep"
    time_shifts_ms: Mapping[str, float] = field(default_factory=dict)
    """Corrections added to the times of the named cameras."""
    splats: bool = False
    """Whether to make a Gaussian splat, too."""

    @property
    def folder(self) -> str:
        """Folder of the unit's result, relative to the batch's folder."""
        return f"{UNITS}/{self.name}/{self.instant:04d}-{self.condition}-{self.key[:16]}"


@dataclass(frozen=True)
class Shard:
    """A part of a batch's units: every `of`th, from the `number`th on, counted from 1."""

    number: int
    of: int

    @classmethod
    def parse(cls, text: str) -> Self:
        """Parse `I/N`; raise BadInputError if it is not that, or I is not one of 1 to N."""
        first, _, second = text.partition("/")
        if first.isdecimal() and second.isdecimal() and 1 <= int(first) <= int(second):
            return cls(int(first), int(second))
        raise BadInputError(f"{text!r} is not a shard", hint="write I/N with I from 1 to N, as in 2/3")

    @property
    def name(self) -> str:
        """Name of the shard in messages and of its lock."""
        return f"shard-{self.number}-of-{self.of}"

    def units(self, units: Sequence[Unit]) -> Sequence[Unit]:
        """Return the shard's units of all of a batch."""
        return units[self.number - 1 :: self.of]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Outcome of a unit; `error` says why there is no result."""

    key: str
    seconds: float = 0.0
    computed: bool = False
    """Whether this run computed it; false if an earlier result was reused."""
    error: str = ""
    exit_code: int = ExitCode.OK


def is_done(unit: Unit, root: Path) -> bool:
    """Return whether the unit's result exists; a folder gets its name only when it is complete."""
    return (root / unit.folder).is_dir()


def run_unit(task: str, unit: Unit, root: Path) -> Outcome:
    """Compute a unit's folder in the batch's folder, unless it exists.

    The task is a function `module:function`, whose name can be sent to other processes and machines. It
    writes a unit's files into an empty folder, the same bytes at each call. If another process is computing
    the folder, wait for that process. Raises nothing, so that a failing unit does not stop the others.
    """
    began = system.monotonic_s()
    code: int = ExitCode.FAILURE
    try:
        computed = _compute(task, unit, root)
        return Outcome(key=unit.key, seconds=system.monotonic_s() - began, computed=computed)
    except (SimulshotError, OSError) as error:
        text, code = str(error), getattr(error, "exit_code", code)
    except MemoryError:
        text = "not enough memory; use fewer --jobs"
    except Exception as error:  # noqa: BLE001  (whatever native code throws)
        text = f"{type(error).__name__}: {error}"
    return Outcome(key=unit.key, error=" ".join(text.split()), exit_code=code)


def _compute(task: str, unit: Unit, root: Path) -> bool:
    # A unit's name identifies its content, so a complete result is never replaced.
    with OutputFolder(root / unit.folder, lambda _: None, wait=True) as output:
        if is_done(unit, root):
            output.discard()
            return False
        _require_free_bytes(root, 64 << 20)
        module, _, function = task.partition(":")
        getattr(import_module(module), function)(unit, output.folder)
        # Native code leaves a truncated file on a full disk without an error.
        _require_free_bytes(root, 1 << 20)
    return True


def remove_leftovers(root: Path) -> None:
    """Remove the unfinished folders of processes that were killed."""
    for folder in (root / UNITS).glob("*"):
        clear_leftovers(folder)


def _require_free_bytes(root: Path, required: int) -> None:
    if shutil.disk_usage(root).free < required:
        raise DiskFullError(f"the disk of {root} is full", hint="free some space, then repeat the command")
