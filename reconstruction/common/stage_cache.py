"""Stages of a computation: paths in, path out, skipped where the output is there already."""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import numpy as np

Result = TypeVar("Result")


VERSION = 8
"""Raised whenever a stage computes something else: old outputs are then made again."""


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

    def arrays(
        self, stage: str, make: Callable[[], dict[str, Any]], *inputs: object
    ) -> dict[str, np.ndarray[Any, Any]]:
        """Named arrays, from the stage's .npz or made and saved there."""
        path = self.path(stage, ".npz", *inputs)
        if not path.exists():
            part = path.with_suffix(".part")
            with part.open("wb") as file:
                np.savez(file, **make())
            part.rename(path)
        with np.load(path) as data:
            return {name: data[name] for name in data.files}

    def record(self, stage: str, kind: type[Result], make: Callable[[], Result], *inputs: object) -> Result:
        """A msgspec struct (or plain data), from the stage's .json or made and saved there."""
        path = self.path(stage, ".json", *inputs)
        if not path.exists():
            part = path.with_suffix(".part")
            part.write_bytes(msgspec.json.encode(make()))
            part.rename(path)
        return msgspec.json.decode(path.read_bytes(), type=kind)
