"""Writing sessions so that a crash at any moment costs at most the image under way."""

import fcntl
import hashlib
import os
import shutil
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec

from capture_app import __version__
from capture_app.errors import BadInputError, SimulshotError
from capture_app.session.calibration import Calibration
from capture_app.session.checks import check_name, check_references
from capture_app.session.durable import AppendOnly, make_folders, sync_folder, write_whole
from capture_app.session.ground_truth import TIMES, TrueTime, TrueTimes, ground_truth_path
from capture_app.session.manifest import (
    CALIBRATION,
    EVENTS,
    JOURNAL,
    MANIFEST,
    BurstRecord,
    CameraRecord,
    ImageRecord,
    Manifest,
    MissingImage,
    image_path,
)
from capture_app.session.reader import Session, SessionSummary, list_sessions
from capture_app.session.synchronization import sync_record

__all__ = ["IMAGE_SUFFIXES", "Session", "SessionSummary", "SessionWriter", "list_sessions"]

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff")


class SessionWriter:
    """One session being written. Methods may be called from any thread; each blocks on the disk."""

    def __init__(self, folder: Path, name: str, created: str = "", software: str = "") -> None:
        self.folder = folder
        self.name = name
        now = datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
        self._created = created or now
        self._software = software or f"simulshot {__version__}"
        self._images: dict[tuple[str, int], ImageRecord] = {}
        self._true_times: dict[tuple[str, int], int] = {}
        self._true_sha256: dict[tuple[str, int], str] = {}
        self._true_clocks: dict[str, dict[str, float | int | str]] = {}
        self._mutex = threading.RLock()
        self._open = True
        self._lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            # A reader asks for the lock only once there is a journal, so nothing but a writer can hold it.
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(self._lock)
            raise BadInputError(f"{folder} is being written by another process") from None
        self._journal = AppendOnly(folder / JOURNAL)
        self._events = AppendOnly(folder / EVENTS)
        sync_folder(folder)

    @classmethod
    def create(cls, root: Path, name: str, *, created: str = "", software: str = "") -> "SessionWriter":
        """Begin the session root/name, locked against other writers until it is finished or aborted.

        `created` (RFC 3339, UTC) and `software` are now and this simulshot unless they are given.
        Raises BadInputError where the name is unsafe, taken, or the folder cannot be made.
        """
        check_name(name, "session")
        folder = Path(root) / name
        try:
            Path(root).mkdir(parents=True, exist_ok=True)
            folder.mkdir()
            sync_folder(Path(root))
        except FileExistsError:
            raise BadInputError(f"{folder} exists already", hint="give the session another name") from None
        except OSError as error:
            raise BadInputError(f"cannot make {folder}: {error.strerror}") from error
        return cls(folder, name, created, software)

    def add_image(
        self,
        data: bytes,
        *,
        camera: str,
        instant: int,
        leader_ns: int,
        suffix: str = ".jpg",
        local_ns: int | None = None,
        residual_ns: int = 0,
        uncertainty_ns: int | None = None,
        hard_bound_ns: int | None = None,
        exposure_start_ns: int | None = None,
        exposure_ns: int | None = None,
        gain: float | None = None,
        white_balance: tuple[float, float] | None = None,
        sequence: int | None = None,
        dropped: bool = False,
        late: bool = False,
    ) -> ImageRecord:
        """Save one image's file bytes as they are; once this returns no crash can lose it.

        Raises BadInputError for an unsafe camera name, an unknown kind of file, an empty image, or an
        image that the session has already.
        """
        check_name(camera, "camera")
        if suffix not in IMAGE_SUFFIXES:
            raise BadInputError(f"images cannot be {suffix!r} files", hint=f"use {', '.join(IMAGE_SUFFIXES)}")
        if not data:
            raise BadInputError(f"camera {camera} sent an empty image of instant {instant}")
        record = ImageRecord(
            camera=camera,
            instant=instant,
            path=image_path(camera, instant, suffix),
            leader_ns=leader_ns,
            bytes=len(data),
            sha256=hashlib.sha256(data).hexdigest(),
            local_ns=local_ns,
            residual_ns=residual_ns,
            uncertainty_ns=uncertainty_ns,
            hard_bound_ns=hard_bound_ns,
            exposure_start_ns=exposure_start_ns,
            exposure_ns=exposure_ns,
            gain=gain,
            white_balance=white_balance,
            sequence=sequence,
            dropped=dropped,
            late=late,
        )
        line = _checked(record, ImageRecord)
        with self._writing():
            if (camera, instant) in self._images:
                raise BadInputError(f"{self.name} has an image of {camera} at instant {instant} already")
            path = self.folder / record.path
            make_folders(path.parent, self.folder)
            write_whole(path, data)
            self._journal.append(line, durable=True)
            self._images[camera, instant] = record
        return record

    def has_image(self, camera: str, instant: int) -> bool:
        """Whether the image of a camera at an instant is saved already."""
        return (camera, instant) in self._images

    def add_event(self, event: Mapping[str, Any]) -> None:
        """Append what the engine saw or did to events.ndjson."""
        with self._writing():
            self._events.append(msgspec.json.encode(event), durable=False)

    def add_ground_truth(self, camera: str, instant: int, data: bytes, true_ns: int) -> Path:
        """Save the .npz of a simulated image and its true first-row time in ns of the host's clock."""
        check_name(camera, "camera")
        with self._writing():
            path = self.folder / ground_truth_path(camera, instant)
            make_folders(path.parent, self.folder)
            write_whole(path, data)
            self._true_times[camera, instant] = true_ns
            self._true_sha256[camera, instant] = hashlib.sha256(data).hexdigest()
        return path

    def add_true_time(self, camera: str, instant: int, true_ns: int) -> None:
        """Keep the true first-row time, in ns of the host's clock, of an image without its .npz."""
        self._true_times[camera, instant] = true_ns

    def set_ground_truth_clocks(self, clocks: Mapping[str, Mapping[str, float | int | str]]) -> None:
        """Keep the true parameters of each simulated camera's clock, by camera and by name with unit."""
        self._true_clocks = {name: dict(values) for name, values in clocks.items()}

    def set_calibration(self, calibration: Calibration) -> None:
        """Save the rig's calibration. Raises BadInputError where it holds what JSON cannot (NaN)."""
        with self._writing():
            write_whole(self.folder / CALIBRATION, _pretty(_checked(calibration, Calibration)))

    def finish(
        self,
        cameras: Sequence[CameraRecord],
        burst: BurstRecord,
        missing: Iterable[MissingImage] = (),
        origin: str = "captured",
        note: str = "",
    ) -> Session:
        """Write the manifest, which makes the session complete, and open the session.

        `origin` is captured, simulated or imported. Raises BadInputError where the records contradict
        each other; the session is then left as it was.
        """
        with self._writing():
            manifest = Manifest(
                name=self.name,
                created=self._created,
                origin=origin,
                software=self._software,
                cameras=tuple(cameras),
                burst=burst,
                images=tuple(sorted(self._images.values(), key=lambda i: (i.instant, i.camera))),
                missing=tuple(sorted(missing, key=lambda m: (m.instant, m.camera))),
                note=note,
            )
            _checked(manifest, Manifest)
            check_references(self.folder / MANIFEST, manifest)
            sync = sync_record(cameras, burst, manifest.images, manifest.missing)
            data = _pretty(_checked(msgspec.structs.replace(manifest, sync=sync), Manifest))
            self._write_true_times()
            self._journal.close()
            self._events.close()
            write_whole(self.folder / MANIFEST, data)
            self._close()
        return Session.open(self.folder)

    def abort(self) -> None:
        """Stop here: what is saved stays, without a manifest. Harmless after `finish` or another abort."""
        with self._mutex:
            if self._open:
                self._close()

    def discard(self) -> None:
        """Stop and delete the folder, for a session that was never meant to exist in part."""
        with self._mutex:
            if self._open:
                self._close()
                shutil.rmtree(self.folder)

    @contextmanager
    def _writing(self) -> Iterator[None]:
        with self._mutex:
            if not self._open:
                raise BadInputError(f"{self.folder} is closed: nothing can be added any more")
            try:
                yield
            except OSError as error:
                raise SimulshotError(
                    f"cannot write {error.filename or self.folder}: {error.strerror}",
                    hint="what was saved before is intact",
                ) from error

    def _close(self) -> None:
        self._open = False
        self._journal.close()
        self._events.close()
        os.close(self._lock)

    def _write_true_times(self) -> None:
        if not self._true_times and not self._true_clocks:
            return
        times = TrueTimes(
            images=tuple(
                TrueTime(camera=of[0], instant=of[1], true_ns=true_ns, sha256=self._true_sha256.get(of))
                for of, true_ns in sorted(self._true_times.items())
            ),
            clocks=self._true_clocks,
        )
        make_folders((self.folder / TIMES).parent, self.folder)
        write_whole(self.folder / TIMES, _pretty(_checked(times, TrueTimes)))


def _checked(value: msgspec.Struct, kind: type[msgspec.Struct]) -> bytes:
    """Encode a struct, and prove that a reader will take it: constructors check nothing."""
    data = msgspec.json.encode(value)
    try:
        msgspec.json.decode(data, type=kind)
    except msgspec.ValidationError as error:
        raise BadInputError(f"a {kind.__name__} that no reader would accept: {error}") from error
    return data


def _pretty(data: bytes) -> bytes:
    return msgspec.json.format(data, indent=1) + b"\n"
