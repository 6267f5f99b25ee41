"""Session writer; a crash at any moment loses at most the images being written."""

import hashlib
import heapq
import os
import shutil
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Self

import msgspec

from capture_app import __version__
from capture_app.common.errors import BadInputError, DiskError, IncompleteError, SimulshotError, TryAgainError
from capture_app.common.names import IMAGE_SUFFIXES, check_name, find_alike
from capture_app.session.files.disk import disk_errors, make_new_folder, reserve
from capture_app.session.files.durable import (
    AppendOnlyFile,
    make_folders,
    sync_all,
    sync_folder,
    write_atomic,
)
from capture_app.session.files.held_folder import HeldFolder
from capture_app.session.files.untrusted_files import encode_checked, indented
from capture_app.session.format.burst_plan import PLAN, BurstPlan, read_plan
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.manifest import (
    CALIBRATION,
    EVENTS,
    MANIFEST,
    BurstRecord,
    CameraRecord,
    ImageRecord,
    Manifest,
    MissingImage,
    check_references,
    image_path,
    sync_record,
)
from capture_app.session.reading.checksums import changed_files, write_checksums
from capture_app.session.reading.reader import INCOMING, Session
from capture_app.session.writing.image_store import ImageStore, StoredImage
from capture_app.session.writing.instant_set import InstantSet
from capture_app.session.writing.recovery import RESERVE
from capture_app.session.writing.video_store import VideoStore

RESERVED_BYTES = 1 << 16
RESERVED_BYTES_PER_IMAGE = 1500
"""Disk space reserved for the manifest and the checksums."""
RESERVED_BYTES_PER_INSTANT, MAX_RESERVED_INSTANTS = 60, 400_000
"""Reserved for a recording, whose length is unknown in advance."""


def encode_manifest(folder: Path, manifest: Manifest, frames: Iterable[ImageRecord] = ()) -> bytes:
    """Add the sync record and encode the manifest; `frames` are the frames of its videos, by instant.

    Raises BadInputError if the records contradict each other.
    """
    encode_checked(manifest)
    check_references(folder / MANIFEST, manifest)
    sync = sync_record(
        manifest.cameras,
        manifest.burst,
        heapq.merge(manifest.images, frames, key=lambda image: image.instant),
        manifest.missing,
    )
    return indented(encode_checked(msgspec.structs.replace(manifest, sync=sync)))


def earlier_note(folder: Path) -> str:
    """Return the note of the manifest to be replaced: the operator may have written it since."""
    try:
        return Session.open(folder).stored_manifest.note
    except (BadInputError, IncompleteError):
        return ""


def _valid_cameras(cameras: Iterable[CameraRecord]) -> tuple[tuple[CameraRecord, ...], dict[str, str]]:
    """Return the cameras that a session can contain, and why each of the others is left out."""
    valid: list[CameraRecord] = []
    reasons: dict[str, str] = {}
    for camera in cameras:
        try:
            encode_checked(camera)
            valid.append(camera)
        except BadInputError as error:
            reasons[camera.name] = f"{camera.name} is left out: {error.what}"
    if not valid:
        raise BadInputError(f"no camera has a valid record: {'; '.join(reasons.values())}")
    return tuple(valid), reasons


class SessionWriter:
    """Writer of one session. Methods may be called from any thread; each blocks on the disk."""

    def __init__(self, folder: Path, name: str, created: str = "", software: str = "") -> None:
        self.name = name
        self.created = created or datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
        self.software = software or f"simulshot {__version__}"
        self._mutex = threading.RLock()
        self.plan: BurstPlan | None = None
        """The burst's plan, from `set_plan` or from the interrupted session."""
        self._open = True
        self._held = HeldFolder(folder)
        try:
            with disk_errors(folder):
                self._recover()
                self._events = AppendOnlyFile(folder / EVENTS)
                # An interrupted writer may have made folders that it did not sync any more.
                for parent, _, _ in os.walk(folder):
                    sync_folder(Path(parent))
        except SimulshotError:
            self._held.close()
            raise

    @classmethod
    def create(cls, root: Path, name: str, *, created: str = "") -> "SessionWriter":
        """Create the session root/name, locked against other writers until it is finished or aborted.

        `created` (RFC 3339, UTC) defaults to now. Raises BadInputError if the name is unsafe or in use, or if
        the folder cannot be created.
        """
        check_name(name, "session")
        folder = Path(root) / name
        make_new_folder(folder)
        try:
            with disk_errors(folder):
                sync_folder(Path(root))
                return cls(folder, name, created)
        except DiskError:
            shutil.rmtree(folder, ignore_errors=True)
            raise

    @classmethod
    def resume(cls, folder: Path) -> "SessionWriter":
        """Reopen an interrupted or incomplete session with its intact images.

        Raises BadInputError if another process is writing it, or if it has no plan.
        """
        plan = read_plan(folder)
        writer = cls(folder, plan.name, plan.created, plan.software)
        if (folder / MANIFEST).exists():
            # After a crash this folder says that the manifest has to be written again.
            with disk_errors(folder):
                make_folders(folder / INCOMING, folder)
        return writer

    @property
    def folder(self) -> Path:
        """The session's folder, which a person may have renamed or moved meanwhile."""
        return self._held.path

    @property
    def moved_to(self) -> Path | None:
        """Where a person has moved its folder, as far as was noticed while it was written."""
        return self._held.moved_to

    def set_plan(self, plan: BurstPlan) -> None:
        """Save the plan of the burst durably; from then on the session can be resumed after a crash.

        Raises DiskFullError if there is no space even for the manifest; BadInputError for two cameras that
        would be one folder on a system that ignores case.
        """
        names = [camera.camera.name for camera in plan.cameras]
        if equal := [name for place, name in enumerate(names) if find_alike(name, names[:place])]:
            raise BadInputError(
                f"two cameras called {equal[0]}, whatever the case, would be one folder on Windows and macOS",
                hint="give one of them a name that differs by more than upper and lower case",
            )
        with self._writing():
            write_atomic(self.folder / PLAN, indented(encode_checked(plan)))
            if self.plan is None:
                needed = RESERVED_BYTES_PER_IMAGE * len(plan.cameras) * len(plan.instants_ns)
                if plan.streamed is not None and plan.streamed.video:
                    needed = RESERVED_BYTES_PER_INSTANT * min(len(plan.instants_ns), MAX_RESERVED_INSTANTS)
                reserve(self.folder / RESERVE, RESERVED_BYTES + needed)
            self._know_plan(plan)

    def add_image(
        self,
        data: bytes,
        *,
        camera: str,
        instant: int,
        leader_ns: int,
        suffix: str = ".jpg",
        truth: bytes = b"",
        true_ns: int | None = None,
        synced: bool = True,
        **further: Any,
    ) -> ImageRecord:
        """Save one image's file bytes unchanged; once this returns, no crash can lose it.

        Unless `synced`, it is in the session after the next `sync`: one for many images costs least.
        `truth` and `true_ns` are fields of `StoredImage`; `further` are further fields of the ImageRecord.
        Raises BadInputError for an unsafe camera name, an unknown file type, an empty image, or one that
        already exists.
        """
        if suffix not in IMAGE_SUFFIXES:
            raise BadInputError(
                f"{suffix!r} is not a supported image format", hint=f"use {', '.join(IMAGE_SUFFIXES)}"
            )
        if not data:
            raise BadInputError(
                f"camera {camera} sent an empty image of instant {instant}", hint="give the bytes of its file"
            )
        record = ImageRecord(
            camera=camera,
            instant=instant,
            path=image_path(camera, instant, suffix),
            leader_ns=leader_ns,
            bytes=len(data),
            sha256=hashlib.sha256(data).hexdigest(),
            **further,
        )
        if self.image(camera, instant) is not None or self.images.is_unsynced(camera, instant):
            raise BadInputError(f"there is an image of {camera} at instant {instant} already")
        (self.save if synced else self.append)([StoredImage(record, data, truth, true_ns)])
        return record

    def save(self, images: Sequence[StoredImage], *, in_videos: bool = False) -> None:
        """Add images, as files or, with `in_videos`, as frames of their cameras' videos.

        After it returns, no crash can lose them. Raises as `append` and `sync`.
        """
        self.append(images, in_videos=in_videos)
        self.sync(*{image.record.camera for image in images})

    def append(self, images: Sequence[StoredImage], *, in_videos: bool = False) -> None:
        """Write images, as `save` does; they are in the session after the next `sync` of their cameras.

        Frames that are here already are skipped. Raises DiskError, TryAgainError once the session is closed,
        and BadInputError if no session can contain one; of its camera, none is added then.
        """
        self._check_open()
        if in_videos:
            # Cameras do not wait for each other.
            for camera in dict.fromkeys(image.record.camera for image in images):
                self.videos.append(camera, [image for image in images if image.record.camera == camera])
        else:
            with self._writing():
                self.images.append(images)

    def sync(self, *cameras: str) -> None:
        """Sync the images that were appended, and these cameras' videos.

        Raises DiskError, TryAgainError; what was appended since the last sync is then not in the session.
        """
        self._check_open()
        for camera in cameras:
            self.videos.sync(camera)
        with self._writing():
            self.images.sync()

    def image(self, camera: str, instant: int) -> ImageRecord | None:
        """Return the record of a saved image, or None."""
        return self.images.records.get((camera, instant)) or self.videos.frame(camera, instant)

    def has(self, camera: str, instant: int) -> bool:
        """Return whether an image is saved."""
        return (camera, instant) in self.images.records or self.videos.has(camera, instant)

    def instants_of(self, camera: str) -> InstantSet:
        """Return the instants for which a camera's image is saved."""
        return InstantSet(
            [*(n for name, n in self.images.records if name == camera), *self.videos.instants(camera)]
        )

    def add_event(self, *events: Mapping[str, Any]) -> None:
        """Append engine events to events.ndjson."""
        with self._writing():
            self._events.append(*(msgspec.json.encode(event) for event in events), durable=False)

    @property
    def knows_true_times(self) -> bool:
        """Whether any image came with its true time, as simulated ones do."""
        return bool(self.images.true_times) or self.videos.knows_true_times

    def set_calibration(self, calibration: Calibration) -> None:
        """Save the rig's calibration. Raises BadInputError if a value cannot be stored as JSON (NaN)."""
        with self._writing():
            write_atomic(self.folder / CALIBRATION, indented(encode_checked(calibration)))

    def finish(
        self,
        cameras: Sequence[CameraRecord],
        burst: BurstRecord,
        missing: Iterable[MissingImage] = (),
        origin: str = "captured",
        note: str = "",
        *,
        plan: BurstPlan | None = None,
        label: str = "",
    ) -> Session:
        """Write the manifest, which makes the session complete, and open the session.

        `label` is what its owner calls it, if not its name. `origin` is captured, simulated or imported;
        entries of `missing` that exist are dropped. `plan` is saved if a full disk did not take it before. A
        camera whose record is not valid is left out: its files are set aside, and the note names it. Raises
        BadInputError if the records contradict each other or no camera is valid; nothing is written then.
        """
        valid, reasons = _valid_cameras(cameras)
        with self._writing():
            note = earlier_note(self.folder) or note
            self.images.leave_out(reasons.keys())
            self.videos.leave_out(reasons.keys())
            # For a video's frame check only whether it exists: its record would be read from disk.
            absent = (
                gap for gap in missing if gap.camera not in reasons and not self.has(gap.camera, gap.instant)
            )
            by_name = {camera.name: camera for camera in valid}
            images = (
                by_name[image.camera].widen(image) if image.camera in by_name else image
                for image in self.images.records.values()
            )
            manifest = Manifest(
                name=self.name,
                created=self.created,
                origin=origin,
                software=self.software,
                cameras=valid,
                burst=burst,
                images=tuple(sorted(images, key=lambda image: (image.instant, image.camera))),
                missing=tuple(sorted(absent, key=lambda m: (m.instant, m.camera))),
                # A session that is finished again already says why a camera is left out.
                note="; ".join(filter(None, (note, *(why for why in reasons.values() if why not in note)))),
                videos=self.videos.records(),
                label=label or msgspec.UNSET,
            )
            data = encode_manifest(self.folder, manifest, self.videos.in_order(len(burst.instants_ns)))
            (self.folder / RESERVE).unlink(missing_ok=True)
            if plan is not None and plan != self.plan:
                # There is room for it now: the reserved space is free.
                write_atomic(self.folder / PLAN, indented(encode_checked(plan)))
            if not self._is_on_disk(data):
                changed = (
                    *self.images.write_truth(),
                    self.folder / EVENTS,
                    write_checksums(self.folder, data),
                )
                for error in sync_all((*changed, self.folder)).values():
                    raise error
                write_atomic(self.folder / MANIFEST, data)
            shutil.rmtree(self.folder / INCOMING, ignore_errors=True)
            self._close()
        return Session.open(self.folder)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.abort()

    def abort(self) -> None:
        """Stop without a manifest; saved images stay. No effect after `finish` or another abort."""
        with self._mutex:
            if self._open:
                self._close()

    def discard(self) -> None:
        """Stop writing, and delete the session's folder."""
        with self._mutex:
            if self._open:
                self._close()
                shutil.rmtree(self.folder)

    def _is_on_disk(self, manifest: bytes) -> bool:
        """Return whether a session that was opened again has not changed since it was finished."""
        path = self.folder / MANIFEST
        return path.is_file() and path.read_bytes() == manifest and not any(changed_files(self.folder))

    def _recover(self) -> None:
        plan = read_plan(self.folder) if (self.folder / PLAN).exists() else None
        self.images = ImageStore(self._held)
        """Images stored as separate files, and the ground truth of all images."""
        self.videos = VideoStore(self._held)
        """Videos of a recording, which contain its frames."""
        if plan is not None:
            self._know_plan(plan)
            # `read_plan` omits the cameras that it cannot trust.
            planned = {part.camera.name for part in plan.cameras}
            self.images.leave_out({camera for camera, _ in self.images.records} - planned)
            self.videos.leave_out({video.camera for video in self.videos.records()} - planned)

    def _know_plan(self, plan: BurstPlan) -> None:
        # The plan allows recovery after a crash, which then needs the true times, too.
        self.plan, self.images.is_crash_safe = plan, True

    @contextmanager
    def _writing(self) -> Iterator[None]:
        with self._mutex:
            self._check_open()
            with self._held.writing():
                yield

    def _check_open(self) -> None:
        if not self._open:
            raise TryAgainError(f"{self.folder} is closed: nothing can be added any more")

    def _close(self) -> None:
        self.videos.close()
        self._open = False
        # All saved images are synced already: an error here loses none.
        self.images.close()
        self._events.close()
        self._held.close()
