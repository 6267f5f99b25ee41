"""Writing sessions so that a crash at any moment costs at most the image under way."""

import hashlib
import os
import shutil
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import msgspec

from capture_app import __version__
from capture_app.errors import BadInputError, DiskFullError, SimulshotError
from capture_app.names import check_name
from capture_app.session.files.disk import disk_error, is_full, reserve
from capture_app.session.files.durable import (
    AppendOnly,
    make_folders,
    move_named,
    sync_folder,
    write_named,
    write_whole,
)
from capture_app.session.files.locks import lock_folder
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.checks import check_references
from capture_app.session.format.encoding import checked, pretty
from capture_app.session.format.journal import Journal
from capture_app.session.format.manifest import (
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
from capture_app.session.format.plan import PLAN, Plan, read_plan
from capture_app.session.reading.checksums import write_checksums
from capture_app.session.reading.reader import Session, SessionSummary, list_sessions
from capture_app.session.reading.synchronization import sync_record
from capture_app.session.writing.recovery import RESERVE, recover_images, remove_leftovers
from capture_app.session.writing.truth_store import TruthStore

__all__ = ["IMAGE_SUFFIXES", "Session", "SessionSummary", "SessionWriter", "list_sessions"]

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff")
RESERVED_BYTES = 1 << 16
RESERVED_BYTES_PER_IMAGE = 1500
"""What the manifest and the checksums may need."""


class SessionWriter:
    """One session being written. Methods may be called from any thread; each blocks on the disk."""

    def __init__(self, folder: Path, name: str, created: str = "", software: str = "") -> None:
        self.folder = folder
        self.name = name
        now = datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
        self.created = created or now
        self.software = software or f"simulshot {__version__}"
        self._images: dict[tuple[str, int], ImageRecord] = {}
        self._truth = TruthStore(folder)
        self._mutex = threading.RLock()
        self._under_way: set[tuple[str, int]] = set()
        self._all_there = threading.Condition(self._mutex)
        self._plan: Plan | None = None
        self.damaged: tuple[tuple[str, int], ...] = ()
        """Images that were saved and are not as they were, of a session that was resumed."""
        self._open = True
        self._lock = lock_folder(folder)
        try:
            self._recover()
            self._journal = Journal(folder / JOURNAL)
            self._events = AppendOnly(folder / EVENTS)
            sync_folder(folder)
        except OSError as error:
            os.close(self._lock)
            raise disk_error(error, folder) from error
        except SimulshotError:
            os.close(self._lock)
            raise

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
        except FileExistsError:
            raise BadInputError(f"{folder} exists already", hint="give the session another name") from None
        except OSError as error:
            if is_full(error):
                raise disk_error(error, folder) from error
            raise BadInputError(f"cannot make {folder}: {error.strerror}") from error
        try:
            sync_folder(Path(root))
            return cls(folder, name, created, software)
        except OSError as error:
            shutil.rmtree(folder, ignore_errors=True)
            raise disk_error(error, folder) from error
        except DiskFullError:
            shutil.rmtree(folder, ignore_errors=True)
            raise

    @classmethod
    def resume(cls, folder: Path) -> "SessionWriter":
        """Go on with a session that a crash interrupted, or that lacks images, from what is safely there.

        Raises BadInputError where another process writes it, or it has no plan to go by.
        """
        plan = read_plan(folder)
        return cls(folder, plan.name, plan.created, plan.software)

    @property
    def plan(self) -> Plan | None:
        """What the session is to become, where that was told."""
        return self._plan

    def set_plan(self, plan: Plan) -> None:
        """Note durably what the session is to become; from then on a crash leaves it to be resumed.

        Raises DiskFullError where not even the manifest will find room.
        """
        with self._writing():
            write_whole(self.folder / PLAN, pretty(checked(plan, Plan)))
            if self._plan is None:
                images = len(plan.cameras) * len(plan.burst.instants_ns)
                reserve(self.folder / RESERVE, RESERVED_BYTES + RESERVED_BYTES_PER_IMAGE * images)
            self._plan = plan

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
        substitute: bool = False,
        late: bool = False,
        outlier_ns: int = 0,
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
            substitute=substitute,
            late=late,
            outlier_ns=outlier_ns,
        )
        self._place(record, lambda path: write_named(path, data))
        return record

    def add_received(self, record: ImageRecord, aside: Path) -> None:
        """Keep an image that lies in the file `aside`, on this disk, with the bytes that its record tells.

        The file is moved into its place; once this returns no crash can lose it. Raises BadInputError.
        """
        check_name(record.camera, "camera")
        suffix = Path(record.path).suffix
        if suffix not in IMAGE_SUFFIXES or record.path != image_path(record.camera, record.instant, suffix):
            raise BadInputError(f"{record.path!r} is no place for an image of {record.camera}")
        self._place(record, lambda path: move_named(aside, path))

    def image(self, camera: str, instant: int) -> ImageRecord | None:
        """The record of an image that is saved already."""
        return self._images.get((camera, instant))

    def has_image(self, camera: str, instant: int) -> bool:
        """Whether the image of a camera at an instant is saved already."""
        return (camera, instant) in self._images

    def add_event(self, *events: Mapping[str, Any]) -> None:
        """Append what the engine saw or did to events.ndjson."""
        with self._writing():
            self._events.append(*(msgspec.json.encode(event) for event in events), durable=False)

    def add_ground_truth(self, camera: str, instant: int, data: bytes | None, true_ns: int) -> Path | None:
        """Save the .npz of a simulated image and its true first-row time in ns of the host's clock.

        Returns where the .npz lies; `data` is None where there is none, only the time.
        """
        check_name(camera, "camera")
        with self._writing():
            return self._truth.add(camera, instant, true_ns, data=data, crash_safe=self._plan is not None)

    @property
    def knows_true_times(self) -> bool:
        """Whether any image came with its true time: the session is a simulated one."""
        return self._truth.knows_times

    def set_ground_truth_clocks(self, clocks: Mapping[str, Mapping[str, float | int | str]]) -> None:
        """Keep the true parameters of each simulated camera's clock, by camera and by name with unit."""
        self._truth.set_clocks(clocks)

    def set_calibration(self, calibration: Calibration) -> None:
        """Save the rig's calibration. Raises BadInputError where it holds what JSON cannot (NaN)."""
        with self._writing():
            write_whole(self.folder / CALIBRATION, pretty(checked(calibration, Calibration)))

    def finish(
        self,
        cameras: Sequence[CameraRecord],
        burst: BurstRecord,
        missing: Iterable[MissingImage] = (),
        origin: str = "captured",
        note: str = "",
    ) -> Session:
        """Write the manifest, which makes the session complete, and open the session.

        `origin` is captured, simulated or imported; of `missing`, what is there is left out. Raises
        BadInputError where the records contradict each other; the session is then left as it was.
        """
        with self._writing():
            while self._under_way:
                self._all_there.wait()
            gone = (gap for gap in missing if (gap.camera, gap.instant) not in self._images)
            manifest = Manifest(
                name=self.name,
                created=self.created,
                origin=origin,
                software=self.software,
                cameras=tuple(cameras),
                burst=burst,
                images=tuple(sorted(self._images.values(), key=lambda i: (i.instant, i.camera))),
                missing=tuple(sorted(gone, key=lambda m: (m.instant, m.camera))),
                note=note,
            )
            checked(manifest, Manifest)
            check_references(self.folder / MANIFEST, manifest)
            sync = sync_record(cameras, burst, manifest.images, manifest.missing)
            data = pretty(checked(msgspec.structs.replace(manifest, sync=sync), Manifest))
            remove_leftovers(self.folder)
            self._truth.write()
            self._events.sync()
            write_checksums(self.folder, data)
            write_whole(self.folder / MANIFEST, data)
            self._close()
        return Session.open(self.folder)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.abort()

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

    def _recover(self) -> None:
        if not (self.folder / JOURNAL).exists() and not (self.folder / PLAN).exists():
            return
        if (self.folder / PLAN).exists():
            self._plan = read_plan(self.folder)
        images, damaged = recover_images(self.folder)
        self.damaged = tuple((image.camera, image.instant) for image in damaged)
        self._images = {(image.camera, image.instant): image for image in images}
        self._truth.recover(images)

    def _place(self, record: ImageRecord, put: Callable[[Path], None]) -> None:
        """Put an image's file in its place and note it; images of several threads go side by side."""
        line = checked(record, ImageRecord)
        of = (record.camera, record.instant)
        path = self.folder / record.path
        with self._writing():
            if of in self._images or of in self._under_way:
                raise BadInputError(f"{self.name} has an image of {of[0]} at instant {of[1]} already")
            make_folders(path.parent, self.folder)
            self._under_way.add(of)
        try:
            put(path)
            self._journal.note(line, path.parent)
        except OSError as error:
            with suppress(OSError):
                path.unlink()
            raise disk_error(error, self.folder) from error
        else:
            self._images[of] = record
        finally:
            with self._mutex:
                self._under_way.discard(of)
                self._all_there.notify_all()

    @contextmanager
    def _writing(self) -> Iterator[None]:
        with self._mutex:
            if not self._open:
                raise BadInputError(f"{self.folder} is closed: nothing can be added any more")
            try:
                yield
            except OSError as error:
                raise disk_error(error, self.folder) from error

    def _close(self) -> None:
        while self._under_way:
            self._all_there.wait()
        self._open = False
        # Nothing that was promised waits in these: a sync that fails now loses no image.
        for file in (self._journal, self._events):
            with suppress(OSError):
                file.close()
        self._truth.close()
        os.close(self._lock)
