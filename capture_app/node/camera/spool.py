"""A node's bursts on its own disk, from when they are encoded until the leader has them.

SPOOL/<camera>/<leader>-<burst>/
  report.json       what the node told the leader of the burst
  journal.ndjson    a line per image: the header that it is sent with
  <instant>.jpg     the image, and behind it a simulated camera's ground truth
"""

import os
import shutil
import threading
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path

import msgspec
from msgspec.structs import replace

from capture_app.errors import BadInputError, DiskError, DiskFullError, TryAgainError
from capture_app.names import check_name
from capture_app.node.wire.messages import CameraReport, ImageUpload, SpoolSpace
from capture_app.session.files.disk import LITTLE_BYTES, disk_error, free_bytes, reserve
from capture_app.session.files.durable import PART, AppendOnlyFile, sync_all, write_atomic, write_unsynced
from capture_app.session.files.locks import lock_folder
from capture_app.session.format.checks import read_struct
from capture_app.session.format.journal import lines_of_file
from capture_app.session.format.manifest import JOURNAL
from capture_app.text import UNREADABLE

REPORT = "report.json"
UNKNOWN_ROOM = 1 << 30
"""What is told, in bytes, of a spool that memory stands in for."""


class SpooledBurst:
    """One burst's folder, of which this object alone writes. Methods block on the disk.

    Threads may share it: what is written after `remove` is not kept.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._changing = threading.Lock()
        self._is_removed = False

    def image_file(self, image: ImageUpload) -> Path:
        """Where an image lies."""
        return self.folder / f"{image.record.instant:06d}{Path(image.record.path).suffix}"

    def write_report(self, report: CameraReport) -> None:
        """Keep the report, through a power cut too. Raises SimulshotError."""
        with self._changing:
            if self._is_removed:
                return
            try:
                write_atomic(self.folder / REPORT, msgspec.json.encode(report))
            except OSError as error:
                raise disk_error(error, self.folder) from error

    def add_image(self, image: ImageUpload, data: bytes) -> None:
        """Keep an image: it outlives this process now, and a power cut after `sync`.

        Raises DiskFullError, SimulshotError.
        """
        with self._changing:
            if self._is_removed:
                return
            try:
                write_unsynced(self.image_file(image), data)
                journal = AppendOnlyFile(self.folder / JOURNAL)
                try:
                    journal.append(msgspec.json.encode(image), durable=False)
                finally:
                    journal.close()
            except OSError as error:
                with suppress(OSError):
                    self.image_file(image).unlink(missing_ok=True)
                raise disk_error(error, self.folder) from error

    def sync(self, images: Iterable[ImageUpload]) -> None:
        """Wait until these images, and the report, are on the disk; those that are gone are left out.

        Their order does not matter: what a power cut has torn is noticed by its checksum. Raises
        DiskFullError, SimulshotError.
        """
        folder = self.folder
        files = [folder / REPORT, folder / JOURNAL, *map(self.image_file, images)]
        for error in sync_all((*files, folder, folder.parent)).values():
            if not isinstance(error, FileNotFoundError):
                raise disk_error(error, folder) from error

    def read_report(self) -> CameraReport:
        """Read the report again. Raises BadInputError."""
        report = read_struct(self.folder / REPORT, CameraReport)
        check_name(report.plan.camera.name, "camera")
        return report

    def read_images(self) -> Iterator[ImageUpload]:
        """Yield the headers of the images that are still here. Raises DiskError."""
        journal = self.folder / JOURNAL
        try:
            lines = lines_of_file(journal.read_bytes()) if journal.exists() else []
        except OSError as error:
            raise disk_error(error, self.folder) from error
        for line in lines:
            try:
                image = msgspec.json.decode(line, type=ImageUpload)
            except UNREADABLE:
                continue
            if self.image_file(image).is_file():
                yield image

    def remove(self) -> None:
        """Delete the burst, of which the leader has all."""
        with self._changing:
            self._is_removed = True
            shutil.rmtree(self.folder, ignore_errors=True)


class Spool:
    """One camera's folder of bursts, locked against other nodes of its name."""

    def __init__(self, root: Path, camera: str) -> None:
        self.camera = check_name(camera, "camera")
        self.folder = root / camera
        self._lock = -1

    def open(self) -> list[SpooledBurst]:
        """Lock the spool and return the bursts in it, oldest first.

        Raises SimulshotError where it cannot be written, TryAgainError where another node uses it.
        """
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._lock = lock_folder(self.folder)
            found = [folder for folder in self.folder.iterdir() if (folder / REPORT).is_file()]
        except TryAgainError:
            raise TryAgainError(
                f"another node uses the spool {self.folder}", hint="give this one another --name or --spool"
            ) from None
        except OSError as error:
            raise BadInputError(
                f"cannot use the spool {self.folder}: {error.strerror}", hint="choose another with --spool"
            ) from error
        return [SpooledBurst(folder) for folder in sorted(found, key=lambda folder: folder.stat().st_mtime)]

    def create_burst(self, report: CameraReport) -> SpooledBurst:
        """Make a burst's folder, with its report; `SpooledBurst.sync` makes both outlive a power cut.

        Raises DiskFullError, SimulshotError.
        """
        burst = SpooledBurst(self.folder / f"{report.leader:08x}-{report.burst:06d}")
        try:
            burst.folder.mkdir(exist_ok=True)
            write_unsynced(burst.folder / REPORT, msgspec.json.encode(report))
        except OSError as error:
            burst.remove()
            raise disk_error(error, self.folder) from error
        return burst

    def look(self) -> SpoolSpace:
        """Return how much room it has, and why it cannot be used, if so. Blocks on the disk."""
        space = SpoolSpace(camera=self.camera, free_bytes=0, spool=str(self.folder))
        probe = self.folder / f"probe{PART}"
        try:
            reserve(probe, LITTLE_BYTES)
            probe.unlink()
            return replace(space, free_bytes=free_bytes(self.folder))
        except OSError as error:
            problem = disk_error(error, self.folder)
        except DiskError as error:
            problem = error
        if isinstance(problem, DiskFullError):
            return replace(space, problem=problem.what)
        # Memory stands in for it, and how much of that there is depends on the leader.
        return replace(space, free_bytes=UNKNOWN_ROOM, problem=problem.what)

    def close(self) -> None:
        """Let another node use it. Calling it twice is harmless."""
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1
