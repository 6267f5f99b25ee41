"""Outputs of a command in its folder: metrics, point clouds, and cached stages for the next run."""

import hashlib
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

import msgspec
import numpy as np

from capture_app.common.text import pretty_json
from capture_app.session.files.durable import write_atomic
from capture_app.session.files.output_folder import OutputFolder, replaces_only
from capture_app.session.reading.decoding import decode_image
from reconstruction.common.geometry import Array

METRICS, REPORT = "metrics.json", "report.html"
STAGES = "stages"
OURS = {METRICS, REPORT, "pictures", "depth.tiff", "depth_filled.tiff", STAGES}
OURS |= {"depth_checked.tiff", "difference.tiff", "registration.json"}
VERSION = 11
"""Incremented whenever a stage's computation changes, so that old outputs are recomputed."""


def comparison_folder(out: Path) -> OutputFolder:
    """Return a folder that replaces an earlier comparison at `out` and starts with its cached stages.

    Raises:
        BadInputError: there is something else at `out`.
    """
    return OutputFolder(out, replaces_only(OURS), reuse=STAGES)


def write_metrics(folder: Path, result: msgspec.Struct) -> None:
    """Write the metrics into a comparison's folder."""
    write_atomic(folder / METRICS, pretty_json(result))


Result = TypeVar("Result")


@dataclass(frozen=True)
class Made(Generic[Result]):
    """Result of a command in Python: `result` as --json prints it, and its files in `folder`.

    A folder that the caller did not name is temporary. It is deleted with this object.
    """

    result: Result
    folder: Path

    def image(self, file: str) -> Array:
        """Return an image file as an array; colours are BGR. Raises OSError if the file does not exist."""
        return np.asarray(decode_image(self.folder.joinpath(file).read_bytes()))


class StageCache:
    """Cache of stage outputs in a folder, each file named by its stage and a key of all its inputs."""

    def __init__(self, folder: Path | None, source: str) -> None:
        """Create a cache; `source` is the fingerprint of the inputs common to all stages.

        Without a folder nothing is stored.
        """
        self.folder = folder
        self.source = source
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)

    def path(self, stage: str, suffix: str, *inputs: object) -> Path | None:
        """Return the path of a stage's output for these inputs, whether it exists or not."""
        if self.folder is None:
            return None
        key = hashlib.sha256(repr((VERSION, self.source, stage, inputs)).encode()).hexdigest()
        return self.folder / f"{stage}-{key[:16]}{suffix}"

    def arrays(self, stage: str, kind: type[Result], make: Callable[[], Result], *inputs: object) -> Result:
        """Return a dataclass of arrays, loaded from the stage's .npz or computed and saved there."""
        if (path := self.path(stage, ".npz", *inputs)) is None:
            return make()
        if not path.exists():
            part = _part(path)
            with part.open("wb") as file:
                np.savez(file, **vars(make()))
            part.rename(path)
        with np.load(path) as data:
            return kind(**{name: data[name] for name in data.files})

    def record(self, stage: str, kind: type[Result], make: Callable[[], Result], *inputs: object) -> Result:
        """Return a msgspec struct (or plain data), loaded from the stage's .json or computed and saved."""
        if (path := self.path(stage, ".json", *inputs)) is None:
            return make()
        if not path.exists():
            part = _part(path)
            part.write_bytes(msgspec.json.encode(make()))
            part.rename(path)
        return msgspec.json.decode(path.read_bytes(), type=kind)


def _part(path: Path) -> Path:
    """Return where a stage is written before it is complete; two threads may compute the same one."""
    return path.with_suffix(f".{threading.get_ident()}.part")
