"""A node's spool: a folder for each burst whose images the leader does not have yet.

SPOOL/<camera>/<leader>-<burst>/
  report.json       the node's report of the burst, as sent to the leader
  <number>.film     its images: see `film_spool`

Nodes of protocol 7 wrote images as files, which are read as well:
  journal.ndjson    a line per image: the header that it is sent with
  <instant>.jpg     the image, followed by a simulated camera's ground truth

All other files in the spool are foreign. They are named, and never read, moved or deleted; nor is anything
behind a link.
"""

import itertools
import os
import re
import threading
from collections.abc import Collection, Iterable, Iterator
from contextlib import suppress
from pathlib import Path

import msgspec
from msgspec.structs import replace

from capture_app.common.bounds import cut
from capture_app.common.errors import (
    BadInputError,
    DiskError,
    DiskFullError,
    SimulshotError,
    TryAgainError,
)
from capture_app.common.names import check_name
from capture_app.node.camera.film_spool import SpooledFilm
from capture_app.protocol.messages import CameraReport, ImageUpload, SpoolSpace
from capture_app.session.files.disk import LITTLE_BYTES, disk_error, disk_errors, free_bytes, reserve
from capture_app.session.files.durable import PART, make_folders, sync_all, write_atomic
from capture_app.session.files.locks import lock_folder
from capture_app.session.files.untrusted_files import decode_struct, read_regular

REPORT = "report.json"
PROBE = f"probe{PART}"
UNKNOWN_ROOM = 1 << 30
"""Free space to report, in bytes, while memory replaces the spool."""
_BURST = re.compile(r"[0-9a-f]{8,16}-[0-9]{6,10}")
_OWN = re.compile(r"report\.json(\.part)?|journal\.ndjson|[0-9]{6,}\.(film|ndjson|jpg)(\.part)?")
"""Names of the files that nodes write into a burst's folder."""


class SpoolFolder:
    """One burst's folder, written by this object alone. Methods block on the disk.

    Threads may share it. Writes after `remove` are discarded.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._changing = threading.Lock()
        self._is_removed = False
        self.film = SpooledFilm(folder)
        """The burst's images."""

    def write_report(self, report: CameraReport) -> None:
        """Store the report, safe against a power cut. Raises SimulshotError."""
        with self._changing, disk_errors(self.folder):
            if not self._is_removed:
                write_atomic(self.folder / REPORT, msgspec.json.encode(report))

    def add(self, images: Iterable[tuple[ImageUpload, bytes]]) -> None:
        """Append images, all or none: they survive this process now, and a power cut after `sync`.

        Raises DiskFullError, SimulshotError.
        """
        with self._changing:
            if not self._is_removed:
                self.film.append(images)

    def sync(self) -> None:
        """Wait until the report and all images that were added are on the disk; deleted files are skipped.

        Their order does not matter, because checksums reveal what a power cut has torn. Raises DiskFullError,
        SimulshotError.
        """
        files = (self.folder / REPORT, *self.film.to_sync(), self.folder, self.folder.parent)
        for error in sync_all(files).values():
            if not isinstance(error, FileNotFoundError):
                raise disk_error(error, self.folder) from error

    def read_report(self) -> CameraReport:
        """Read the stored report.

        Raises BadInputError if it is missing or damaged, or of another burst or camera.
        """
        path = self.folder / REPORT
        try:
            data = read_regular(path, follow_links=False)
        except OSError as error:
            raise BadInputError(f"cannot read {path}: {error.strerror}") from error
        report = decode_struct(path, data, CameraReport)
        if (folder_name(report), report.camera) != (self.folder.name, self.folder.parent.name):
            raise BadInputError(f"{path} is of another burst or camera")
        return report

    def unknown(self) -> list[Path]:
        """Return foreign files, and what an earlier run has left and this version does not understand."""
        with suppress(OSError, SimulshotError):
            [*self.film.recover()]
            names = [path for path in self.folder.iterdir() if not _is_own_file(path)]
            return [*sorted(names), *self.film.unreadable]
        return []

    def remove(self) -> bool:
        """Delete the burst's own files, once the leader has all of it; return whether the disk has done so.

        What is not understood stays, and its folder with it.
        """
        with self._changing:
            self._is_removed = True
            self.film.close()
            own = kept = 0
            # The report goes last: without it, a restarted node would not find what is left.
            with suppress(OSError):
                self.film.forget_readable()
                for file in sorted(self.folder.iterdir(), key=lambda file: file.name == REPORT):
                    is_needed = bool(self.film.unreadable) and file.name == REPORT
                    if is_needed or not _is_own_file(file) or self.film.keeps(file):
                        kept += 1
                    else:
                        own += 1
                        file.unlink()
                        own -= 1
                if not kept:
                    self.folder.rmdir()
            return not self.folder.exists() or bool(kept and not own)


def _is_own_file(path: Path) -> bool:
    return _OWN.fullmatch(path.name) is not None and path.is_file() and not path.is_symlink()


def is_burst_folder(folder: Path) -> bool:
    """Return whether this can be the folder of a burst, by its name and without following a link."""
    return _BURST.fullmatch(folder.name) is not None and folder.is_dir() and not folder.is_symlink()


def unknown_in(folder: Path) -> Iterator[Path]:
    """Yield what is in a camera's spool and is foreign by its name, or has no report. Raises OSError."""
    if folder.is_symlink():
        yield folder
        return
    for path in sorted(folder.iterdir()):
        if is_burst_folder(path):
            has_report = _is_own_file(path / REPORT)
            yield from SpoolFolder(path).unknown() if has_report else [path] * any(path.iterdir())
        elif path.name != PROBE:
            yield path


def folder_name(report: CameraReport) -> str:
    """Return the name of a burst's folder in any spool."""
    return f"{report.leader:08x}-{report.burst:06d}"


def _spool_roots(spool: Path) -> Iterator[Path]:
    """Yield SPOOL, SPOOL/.2, SPOOL/.3 ..., where rigs of one machine may have a camera of one name each.

    `spool` is any of them.
    """
    first = spool.parent if spool.name[:1] == "." and spool.name[1:].isdecimal() else spool
    yield first
    yield from (first / f".{number}" for number in itertools.count(2))


def free_spool(spool: Path, camera: str) -> Path:
    """Return `spool`, or its `.2`, `.3` ... while nodes of that name run or end in those before."""
    for root in _spool_roots(spool):
        with suppress(TryAgainError):
            if (root / camera).is_dir():
                os.close(lock_folder(root / camera))
            return root
    raise AssertionError("there is always one more")


class Spool:
    """One camera's folder of bursts, locked against other nodes of its name."""

    def __init__(self, root: Path, camera: str) -> None:
        self.camera = check_name(camera, "camera")
        self.folder = root / camera
        self._root = root
        self._lock = -1
        self._left: list[SpoolFolder] = []
        """Bursts that a failing disk has not deleted."""
        self._changing = threading.Lock()

    def open(self) -> list[SpoolFolder]:
        """Lock the spool and return the bursts in it, oldest first.

        Raises SimulshotError where it cannot be written, TryAgainError where another node uses it.
        """
        try:
            make_folders(self.folder, Path(self.folder.anchor))
            self._lock = lock_folder(self.folder)
            self.adopt()
            folders = [*filter(is_burst_folder, self.folder.iterdir())]
            bursts = [folder for folder in folders if _is_own_file(folder / REPORT)]
            for folder in (folder for folder in folders if folder not in bursts):
                # The node was stopped while it made or removed the folder. One with images stays.
                with suppress(OSError):
                    if _is_own_file(part := folder / f"{REPORT}{PART}"):
                        part.unlink()
                    folder.rmdir()
        except TryAgainError:
            raise TryAgainError(
                f"another node uses the spool {self.folder}", hint="give this one another --name or --spool"
            ) from None
        except OSError as error:
            raise BadInputError(
                f"cannot use the spool {self.folder}: {error.strerror}", hint="choose another with --spool"
            ) from error
        return [SpoolFolder(folder) for folder in sorted(bursts, key=lambda folder: folder.stat().st_mtime)]

    def adopt(self, under_way: Collection[str] = ()) -> list[SpoolFolder]:
        """Move bursts here that ended nodes of this name left in the other spools of this machine.

        Return their folders. A burst that is `under_way` here, by its folder's name, stays for later. Blocks
        on the disk.
        """
        moved = []
        for root in itertools.takewhile(lambda root: (root / self.camera).is_dir(), _spool_roots(self._root)):
            if root == self._root or (root / self.camera).is_symlink():
                continue
            with suppress(SimulshotError, OSError):
                lock = lock_folder(root / self.camera)
                try:
                    for left in filter(is_burst_folder, [*(root / self.camera).iterdir()]):
                        folder = self.folder / left.name
                        if folder.name in under_way or folder.is_symlink() or folder.exists():
                            continue
                        with suppress(BadInputError):
                            SpoolFolder(left).read_report()
                            left.rename(folder)
                            moved.append(SpoolFolder(folder))
                finally:
                    os.close(lock)
        return moved

    def create_burst(self, report: CameraReport) -> SpoolFolder:
        """Create a burst's folder with its report; `SpoolFolder.sync` secures both against a power cut.

        Raises DiskFullError, SimulshotError.
        """
        burst = SpoolFolder(self.folder / folder_name(report))
        if burst.folder.is_symlink():
            raise DiskError(f"{burst.folder} is a link", hint="remove it: nodes write nothing behind links")
        try:
            with self._changing:
                # A recording that goes on has the same folder again, which must not be deleted later.
                self._left = [left for left in self._left if left.folder != burst.folder]
                burst.folder.mkdir(exist_ok=True)
                write_atomic(burst.folder / REPORT, msgspec.json.encode(report), synced=False)
        except OSError as error:
            burst.remove()
            raise disk_error(error, self.folder) from error
        return burst

    def remove(self, burst: SpoolFolder) -> None:
        """Delete a burst, now or when its disk can do so again."""
        with self._changing:
            if not burst.remove():
                self._left.append(burst)

    def look(self) -> SpoolSpace:
        """Return the free space, and the reason if the spool cannot be used; delete what could not be before.

        Blocks on the disk.
        """
        space = SpoolSpace(camera=self.camera, free_bytes=0, spool=str(self.folder))
        probe = self.folder / PROBE
        try:
            with disk_errors(self.folder):
                reserve(probe, LITTLE_BYTES)
                probe.unlink()
                with self._changing:
                    self._left = [burst for burst in self._left if not burst.remove()]
                return replace(space, free_bytes=free_bytes(self.folder))
        except DiskFullError as error:
            return replace(space, problem=cut(error.what))
        except DiskError as error:
            # Memory replaces it, and the amount needed depends on the leader.
            return replace(space, free_bytes=UNKNOWN_ROOM, problem=cut(error.what))

    def close(self) -> None:
        """Release the spool for another node. Calling it twice is harmless."""
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1
