"""The folder of a comparison: it appears whole or not at all, and never over somebody else's files."""

import errno
import os
import shutil
from pathlib import Path
from types import TracebackType
from typing import Self

import msgspec

from capture_app.errors import BadInputError, SimulshotError
from capture_app.session.files.durable import write_whole

METRICS = "metrics.json"
STAGES = "stages"
LITTLE_BYTES = 1 << 20
"""With less than this on a disk, what could not be written there failed for want of room."""
OURS = {METRICS, "report.html", "pictures", "depth.tiff", STAGES}


class Output:
    """A folder being made beside its place, and moved there when it is finished."""

    def __init__(self, target: Path) -> None:
        """An earlier comparison at `target` is replaced; its stages are used again.

        Raises:
            BadInputError: there is something else at `target`, or it cannot be written.
        """
        self.target = target.absolute()
        self.folder = self.target.with_name(f".{self.target.name}.{os.getpid()}.part")
        self._finished = False
        self._refuse_foreign()

    def __enter__(self) -> Self:
        """Make the working folder."""
        try:
            self.folder.mkdir(parents=True)
            stages = self.target / STAGES
            if stages.is_dir():
                shutil.copytree(stages, self.folder / STAGES, copy_function=os.link)
        except OSError as error:
            raise BadInputError(
                f"cannot write to {self.target}: {error.strerror or error}", hint="choose another --out"
            ) from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leave nothing half-made."""
        full = full_disk(value, self.folder, self.target)
        if not self._finished:
            shutil.rmtree(self.folder, ignore_errors=True)
        if full is not None:
            raise full from value

    def finish(self, result: msgspec.Struct) -> None:
        """Write the metrics and put the folder in its place."""
        write_whole(self.folder / METRICS, msgspec.json.format(msgspec.json.encode(result), indent=2))
        old = self.target.with_name(f".{self.target.name}.{os.getpid()}.old")
        if self.target.exists():
            self.target.rename(old)
        self.folder.rename(self.target)
        self._finished = True
        shutil.rmtree(old, ignore_errors=True)

    def _refuse_foreign(self) -> None:
        if not self.target.exists():
            return
        if not self.target.is_dir():
            raise BadInputError(f"{self.target} is a file", hint="choose another --out")
        foreign = sorted(path.name for path in self.target.iterdir() if path.name not in OURS)
        if foreign:
            raise BadInputError(
                f"{self.target} holds other files ({foreign[0]})", hint="choose a new folder for --out"
            )


def full_disk(error: BaseException | None, part: Path, target: Path) -> SimulshotError | None:
    """What to say instead of an error in writing to `part` where its disk is full; None = it is not."""
    if not isinstance(error, OSError) or not part.is_dir():
        return None
    if error.errno != errno.ENOSPC and shutil.disk_usage(part).free >= LITTLE_BYTES:
        return None
    return SimulshotError(
        f"no space is left on the disk for {target}", hint="free some, or choose an --out on another disk"
    )
