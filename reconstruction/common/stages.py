"""Stages of a computation: paths in, path out, skipped where the output is there already."""

import hashlib
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click
import msgspec
import numpy as np

Result = TypeVar("Result")
VERSION = 2
"""Raised whenever a stage computes something else: old outputs are then made again."""


class Progress:
    """Progress lines on stderr, `[3/9] what`, one for each step."""

    def __init__(self, total: int, *, silent: bool = False) -> None:
        """`silent`: count only, as a part of what another progress tells."""
        self.total = total
        self.done = 0
        self.silent = silent

    def step(self, text: str) -> None:
        """Say what begins now."""
        self.done += 1
        self.total = max(self.total, self.done)
        if self.silent:
            return
        click.echo(f"[{self.done}/{self.total}] {text}", err=True)
        sys.stderr.flush()

    def last(self, text: str) -> None:
        """Say what comes last, whatever was skipped before."""
        self.done = max(self.done, self.total - 1)
        self.step(text)


class Stages:
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
