"""The folder of a multi-view result: it appears whole or not at all, and never over somebody else's files."""

import os
import shutil
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

from capture_app.errors import BadInputError
from reconstruction.common.output_folder import full_disk


@contextmanager
def whole_folder(out: Path, ours: Collection[str]) -> Iterator[Path]:
    """A folder to work in, which takes the place of `out` at the end; after an error nothing is left.

    Raises:
        BadInputError: `out` cannot be written, or holds other things than `ours`.
        SimulshotError: the disk is full.
    """
    refuse_foreign(out, ours)
    target = out.absolute()
    part = target.with_name(f".{target.name}.{os.getpid()}.part")
    old = target.with_name(f".{target.name}.{os.getpid()}.old")
    try:
        try:
            part.mkdir(parents=True)
        except OSError as error:
            raise BadInputError(
                f"cannot write to {part.parent}: {error.strerror or error}", hint="choose another --out"
            ) from error
        try:
            yield part
        except OSError as error:
            full = full_disk(error, part, target)
            if full is None:
                raise
            raise full from error
        if target.exists():
            target.rename(old)
        part.rename(target)
    finally:
        shutil.rmtree(part, ignore_errors=True)
        shutil.rmtree(old, ignore_errors=True)


def refuse_foreign(out: Path, ours: Collection[str]) -> None:
    """Raises BadInputError where there is something else at `out` than an earlier result."""
    if not out.exists():
        return
    if not out.is_dir():
        raise BadInputError(f"{out} is a file", hint="choose another --out")
    foreign = sorted(path.name for path in out.iterdir() if path.name not in ours)
    if foreign:
        raise BadInputError(f"{out} holds other files ({foreign[0]})", hint="choose a new folder for --out")
