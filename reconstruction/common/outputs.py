"""What a command leaves in its folder: metrics, clouds of points, and stages that the next run uses again."""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import msgspec
import numpy as np

from capture_app.common.text import pretty_json
from capture_app.session.files.durable import write_atomic
from capture_app.session.files.output_folder import OutputFolder, replaces_only

METRICS = "metrics.json"
STAGES = "stages"
OURS = {METRICS, "report.html", "pictures", "depth.tiff", "depth_filled.tiff", STAGES}
VERSION = 9
"""Raised whenever a stage computes something else: old outputs are then made again."""


def comparison_folder(out: Path) -> OutputFolder:
    """A folder that takes the place of an earlier comparison at `out`, and begins with its stages.

    Raises:
        BadInputError: there is something else at `out`.
    """
    return OutputFolder(out, replaces_only(OURS), reuse=STAGES)


class Provenance(msgspec.Struct, frozen=True, kw_only=True):
    """How a result was made: what every command says of its own run."""

    time_shifts_ms: dict[str, float] = {}
    """What was added to the times of these cameras."""
    seconds: float = 0.0
    """All of it, wall time."""
    memory_notes: tuple[str, ...] = ()
    """What the memory budget changed."""
    changed_pictures: tuple[str, ...] = ()
    """Files whose bytes are not those that were saved."""
    versions: dict[str, str] = {}
    """Of the libraries that made it."""


def write_metrics(folder: Path, result: msgspec.Struct) -> None:
    """Write what was measured into a comparison's folder."""
    write_atomic(folder / METRICS, pretty_json(result))


Result = TypeVar("Result")


class StageCache:
    """A folder of outputs, each named after its stage and a key over everything that it depends on."""

    def __init__(self, folder: Path, source: str) -> None:
        """`source` is the fingerprint of the inputs that all stages share."""
        self.folder = folder
        self.source = source
        folder.mkdir(parents=True, exist_ok=True)

    def path(self, stage: str, suffix: str, *inputs: object) -> Path:
        """Where a stage's output for these inputs lies, there or not."""
        text = repr((VERSION, self.source, stage, inputs))
        return self.folder / f"{stage}-{hashlib.sha256(text.encode()).hexdigest()[:16]}{suffix}"

    def arrays(self, stage: str, kind: type[Result], make: Callable[[], Result], *inputs: object) -> Result:
        """A dataclass of arrays, from the stage's .npz or made and saved there."""
        path = self.path(stage, ".npz", *inputs)
        if not path.exists():
            part = path.with_suffix(".part")
            with part.open("wb") as file:
                np.savez(file, **vars(make()))
            part.rename(path)
        with np.load(path) as data:
            return kind(**{name: data[name] for name in data.files})

    def record(self, stage: str, kind: type[Result], make: Callable[[], Result], *inputs: object) -> Result:
        """A msgspec struct (or plain data), from the stage's .json or made and saved there."""
        path = self.path(stage, ".json", *inputs)
        if not path.exists():
            part = path.with_suffix(".part")
            part.write_bytes(msgspec.json.encode(make()))
            part.rename(path)
        return msgspec.json.decode(path.read_bytes(), type=kind)
