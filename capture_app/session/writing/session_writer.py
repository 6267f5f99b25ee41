"""Writes a session so that a crash at any moment loses at most the images being written."""

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
from capture_app.common.errors import BadInputError, DiskError, IncompleteError, SimulshotError
from capture_app.common.names import check_name
from capture_app.session.files.disk import disk_errors, make_new_folder, reserve
from capture_app.session.files.durable import (
    AppendOnlyFile,
    sync_all,
    sync_folder,
    write_atomic,
)
from capture_app.session.files.locks import lock_folder
from capture_app.session.files.strangers import encode_checked, indented
from capture_app.session.format.burst_plan import PLAN, BurstPlan, read_plan
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.manifest import (
    CALIBRATION,
    EVENTS,
    IMAGE_SUFFIXES,
    JOURNAL,
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
from capture_app.session.reading.checksums import write_checksums
from capture_app.session.reading.reader import Session
from capture_app.session.writing.image_store import ImageStore, StoredImage
from capture_app.session.writing.instant_set import InstantSet
from capture_app.session.writing.recovery import RESERVE, remove_leftovers
from capture_app.session.writing.video_store import VideoStore

RESERVED_BYTES = 1 << 16
RESERVED_BYTES_PER_IMAGE = 1500
"""What the manifest and the checksums may need."""
RESERVED_BYTES_PER_INSTANT, MOST_RESERVED_INSTANTS = 60, 400_000
"""Reserved for a recording, of which nobody knows how long it will be."""


def reserve_room(folder: Path, plan: BurstPlan) -> None:
    """Keep room on the disk for the manifest of a burst. Raises OSError where there is none."""
    instants = len(plan.instants_ns)
    if plan.streamed is not None and plan.streamed.video:
        needed = RESERVED_BYTES_PER_INSTANT * min(instants, MOST_RESERVED_INSTANTS)
    else:
        needed = RESERVED_BYTES_PER_IMAGE * len(plan.cameras) * instants
    reserve(folder / RESERVE, RESERVED_BYTES + needed)


def encode_manifest(folder: Path, manifest: Manifest, frames: Iterable[ImageRecord] = ()) -> bytes:
    """Add the sync record and encode; `frames` are those of its videos, in the order of their instants.

    Raises BadInputError where the records contradict each other.
    """
    encode_checked(manifest)
    check_references(folder / MANIFEST, manifest)
    images = heapq.merge(manifest.images, frames, key=lambda image: image.instant)
    sync = sync_record(manifest.cameras, manifest.burst, images, manifest.missing)
    return indented(encode_checked(msgspec.structs.replace(manifest, sync=sync)))


def earlier_note(folder: Path) -> str:
    """The note of a manifest that is replaced: somebody may have written it since."""
    try:
        return Session.open(folder).stored_manifest.note
    except (BadInputError, IncompleteError):
        return ""


def write_manifest(folder: Path, data: bytes, before: Iterable[Path]) -> None:
    """Write the checksums and then the manifest, which makes the session complete. Raises OSError.

    The files and folders `before` it are synced first, all at once.
    """
    checksums = write_checksums(folder, data)
    for error in sync_all((*before, checksums, folder)).values():
        raise error
    write_atomic(folder / MANIFEST, data)


class SessionWriter:
    """One session being written. Methods may be called from any thread; each blocks on the disk."""

    def __init__(self, folder: Path, name: str, created: str = "", software: str = "") -> None:
        self.folder = folder
        self.name = name
        now = datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
        self.created = created or now
        self.software = software or f"simulshot {__version__}"
        self._mutex = threading.RLock()
        self.images = ImageStore(folder)
        """The images that are files of their own, and the truth of all."""
        self.videos = VideoStore(folder)
        """The videos of a recording, whose frames are no files of their own."""
        self.plan: BurstPlan | None = None
        """The plan of the burst, where `set_plan` was called or an interrupted session had one."""
        self._open = True
        self._lock = lock_folder(folder)
        try:
            with disk_errors(folder):
                self._recover()
                self._events = AppendOnlyFile(folder / EVENTS)
                sync_folder(folder)
        except SimulshotError:
            os.close(self._lock)
            raise

    @classmethod
    def create(cls, root: Path, name: str, *, created: str = "") -> "SessionWriter":
        """Begin the session root/name, locked against other writers until it is finished or aborted.

        `created` (RFC 3339, UTC) defaults to now.
        Raises BadInputError where the name is unsafe, taken, or the folder cannot be made.
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
        """Reopen a session that a crash interrupted, or that lacks images, with the images that are safe.

        Raises BadInputError where another process writes it, or it has no plan to go by.
        """
        plan = read_plan(folder)
        return cls(folder, plan.name, plan.created, plan.software)

    def set_plan(self, plan: BurstPlan) -> None:
        """Save the plan of the burst durably; after a crash the session can be resumed from then on.

        Raises DiskFullError where not even the manifest will find room.
        """
        with self._writing():
            write_atomic(self.folder / PLAN, indented(encode_checked(plan)))
            if self.plan is None:
                reserve_room(self.folder, plan)
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
        **further: Any,
    ) -> ImageRecord:
        """Save one image's file bytes as they are; once this returns no crash can lose it.

        `truth` and `true_ns` are those of `StoredImage`, `further` what is known of its ImageRecord. Raises
        BadInputError for an unsafe camera name, an unknown kind of file, an empty image, or one that is there
        already.
        """
        if suffix not in IMAGE_SUFFIXES:
            raise BadInputError(
                f"{suffix!r} is not a supported image format", hint=f"use {', '.join(IMAGE_SUFFIXES)}"
            )
        if not data:
            raise BadInputError(f"camera {camera} sent an empty image of instant {instant}")
        record = ImageRecord(
            camera=camera,
            instant=instant,
            path=image_path(camera, instant, suffix),
            leader_ns=leader_ns,
            bytes=len(data),
            sha256=hashlib.sha256(data).hexdigest(),
            **further,
        )
        for error in self.save([StoredImage(record, data, truth, true_ns)]):
            if error is not None:
                raise error
        return record

    def save(self, images: Sequence[StoredImage], *, in_videos: bool = False) -> list[SimulshotError | None]:
        """Add images, as files, or `in_videos` as frames to the videos of their cameras.

        The disk is synced once for all of them, or once for each video; once this returns no crash can lose
        one, unless it has an error in the answer. A frame that its video has already is left out.
        """
        try:
            with self._writing():
                return self.videos.save(images) if in_videos else self.images.save(images)
        except SimulshotError as error:
            return [error] * len(images)

    def image(self, camera: str, instant: int) -> ImageRecord | None:
        """The record of an image that is saved already; None where it is not."""
        return self.images.get(camera, instant) or self.videos.frame(camera, instant)

    def instants_of(self, camera: str) -> InstantSet:
        """The instants of which a camera's image is saved."""
        return InstantSet([*self.images.instants(camera), *self.videos.instants(camera)])

    def add_event(self, *events: Mapping[str, Any]) -> None:
        """Append what the engine saw or did to events.ndjson."""
        with self._writing():
            self._events.append(*(msgspec.json.encode(event) for event in events), durable=False)

    @property
    def knows_true_times(self) -> bool:
        """Whether any image came with its true time, as simulated ones do."""
        return bool(self.images.true_times) or self.videos.knows_true_times

    def set_calibration(self, calibration: Calibration) -> None:
        """Save the rig's calibration. Raises BadInputError where it holds what JSON cannot (NaN)."""
        with self._writing():
            write_atomic(self.folder / CALIBRATION, indented(encode_checked(calibration)))

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
            # Not of a video's frame what it is, which would be read from the disk: only whether it is there.
            gone = (
                gap
                for gap in missing
                if self.images.get(gap.camera, gap.instant) is None
                and not self.videos.has(gap.camera, gap.instant)
            )
            manifest = Manifest(
                name=self.name,
                created=self.created,
                origin=origin,
                software=self.software,
                cameras=tuple(cameras),
                burst=burst,
                images=self.images.records,
                missing=tuple(sorted(gone, key=lambda m: (m.instant, m.camera))),
                note=earlier_note(self.folder) or note,
                videos=self.videos.records(),
            )
            data = encode_manifest(self.folder, manifest, self.videos.in_order(burst.instants_ns))
            remove_leftovers(self.folder)
            write_manifest(self.folder, data, (*self.images.write_truth(), self.folder / EVENTS))
            self._close()
        return Session.open(self.folder)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.abort()

    def abort(self) -> None:
        """Stop without a manifest; what is saved stays. Harmless after `finish` or another abort."""
        with self._mutex:
            if self._open:
                self._close()

    def discard(self) -> None:
        """Stop and delete the folder."""
        with self._mutex:
            if self._open:
                self._close()
                shutil.rmtree(self.folder)

    def _recover(self) -> None:
        if (self.folder / PLAN).exists():
            self._know_plan(read_plan(self.folder))
        interrupted = self.plan is not None or (self.folder / JOURNAL).exists()
        self.images.open(recover=interrupted)
        if interrupted:
            self.videos.recover()

    def _know_plan(self, plan: BurstPlan) -> None:
        # A crash is mended by the plan, and then the true times are wanted, too.
        self.plan, self.images.is_crash_safe = plan, True

    @contextmanager
    def _writing(self) -> Iterator[None]:
        with self._mutex:
            if not self._open:
                raise BadInputError(f"{self.folder} is closed: nothing can be added any more")
            with disk_errors(self.folder):
                yield

    def _close(self) -> None:
        self.videos.close()
        self._open = False
        # All saved images are synced already: an error here loses none.
        self.images.close()
        self._events.close()
        os.close(self._lock)
