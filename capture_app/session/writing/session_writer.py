"""Writes a session so that a crash at any moment loses at most the image being written.

The manifest that completes a session: reserves room for it, checks it and writes it.

Writes the ground truth of a simulated session, as safely as its images.
"""

import hashlib
import heapq
import os
import shutil
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Self

import msgspec

from capture_app import __version__
from capture_app.clock import SimulatedClock
from capture_app.errors import BadInputError, DiskFullError, IncompleteError, SimulshotError
from capture_app.names import check_name
from capture_app.session.files.disk import disk_error, make_new_folder, reserve
from capture_app.session.files.durable import (
    AppendOnlyFile,
    make_folders_unsynced,
    sync_all,
    sync_folder,
    write_atomic,
    write_unsynced,
)
from capture_app.session.files.locks import lock_folder
from capture_app.session.format.burst_plan import PLAN, BurstPlan, read_plan
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.checks import check_references, encode_checked, indented
from capture_app.session.format.ground_truth import (
    TIMES,
    TRUE_TIMES_JOURNAL,
    TrueTime,
    TrueTimes,
    ground_truth_path,
)
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
)
from capture_app.session.reading.checksums import write_checksums
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verdict import sync_record
from capture_app.session.writing.image_store import ImageStore, NewImage, ReceivedImage, new_image
from capture_app.session.writing.instant_set import InstantSet
from capture_app.session.writing.recovery import RESERVE, recover_true_times, remove_leftovers
from capture_app.session.writing.video_store import NewFrame, VideoStore

RESERVED_BYTES = 1 << 16
RESERVED_BYTES_PER_IMAGE = 1500
"""What the manifest and the checksums may need."""
RESERVED_BYTES_PER_INSTANT, MOST_RESERVED_INSTANTS = 60, 400_000
"""The same of a recording, of which nobody knows how long it will be."""


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
    encode_checked(manifest, Manifest)
    check_references(folder / MANIFEST, manifest)
    images = heapq.merge(manifest.images, frames, key=lambda image: image.instant)
    sync = sync_record(manifest.cameras, manifest.burst, images, manifest.missing)
    return indented(encode_checked(msgspec.structs.replace(manifest, sync=sync), Manifest))


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


class TruthStore:
    """The ground truth of one session being written; all methods may raise OSError."""

    def __init__(self, folder: Path, make_folders: Callable[[Path], None]) -> None:
        """`make_folders` makes a folder in the session, which `add` leaves to be synced."""
        self._folder = folder
        self._make_folders = make_folders
        self._times: dict[tuple[str, int], TrueTime] = {}
        self._clocks: dict[str, SimulatedClock] = {}
        self._journal: AppendOnlyFile | None = None

    @property
    def knows_times(self) -> bool:
        """Whether any image came with its true time."""
        return bool(self._times)

    def recover(self, images: Iterable[ImageRecord]) -> None:
        """Read the true times of these images that an interrupted writer has left."""
        self._times = recover_true_times(self._folder, images)

    def add(
        self, camera: str, instant: int, true_ns: int, *, data: bytes | None, crash_safe: bool
    ) -> tuple[Path, ...]:
        """Keep an image's true first-row time in ns of the host's clock, and its .npz where there is one.

        With `crash_safe` the time survives a crash; else it is written with the manifest only. Returns the
        files and folders that are still to be synced.
        """
        changed: tuple[Path, ...] = ()
        if data is not None:
            path = self._folder / ground_truth_path(camera, instant)
            self._make_folders(path.parent)
            write_unsynced(path, data)
            changed = path, path.parent
        sha256 = None if data is None else hashlib.sha256(data).hexdigest()
        true = TrueTime(camera=camera, instant=instant, true_ns=true_ns, sha256=sha256)
        self._times[camera, instant] = true
        if crash_safe:
            journal = self._folder / TRUE_TIMES_JOURNAL
            if self._journal is None:
                self._make_folders(journal.parent)
                self._journal = AppendOnlyFile(journal)
            self._journal.append(msgspec.json.encode(true), durable=False)
            changed = *changed, journal, journal.parent
        return changed

    def set_clocks(self, clocks: Mapping[str, SimulatedClock]) -> None:
        """Keep each camera's clock as it really is."""
        self._clocks = dict(clocks)

    def write(self) -> tuple[Path, ...]:
        """Write times.json, unless no true time and no clock is known; return what is still to be synced."""
        if not self._times and not self._clocks:
            return ()
        images = tuple(true for _, true in sorted(self._times.items()))
        times = TrueTimes(images=images, clocks=self._clocks)
        path = self._folder / TIMES
        changed = make_folders_unsynced(path.parent, self._folder)
        write_unsynced(path, indented(encode_checked(times, TrueTimes)))
        return path, path.parent, *changed

    def close(self) -> None:
        """Close the journal: all saved times are in it already."""
        if self._journal is not None:
            with suppress(OSError):
                self._journal.close(synced=False)


class SessionWriter:
    """One session being written. Methods may be called from any thread; each blocks on the disk."""

    def __init__(self, folder: Path, name: str, created: str = "", software: str = "") -> None:
        self.folder = folder
        self.name = name
        now = datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
        self.created = created or now
        self.software = software or f"simulshot {__version__}"
        self._mutex = threading.RLock()
        self._images = ImageStore(folder, self._mutex)
        self._truth = TruthStore(folder, self._images.make_folders)
        self.videos = VideoStore(folder)
        """Of a recording, whose frames are no files of their own."""
        self.plan: BurstPlan | None = None
        """The plan of the burst, where `set_plan` was called or an interrupted session had one."""
        self._open = True
        self._lock = lock_folder(folder)
        try:
            self._recover()
            self._events = AppendOnlyFile(folder / EVENTS)
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

        `created` (RFC 3339, UTC) defaults to now, `software` to this version of simulshot.
        Raises BadInputError where the name is unsafe, taken, or the folder cannot be made.
        """
        check_name(name, "session")
        folder = Path(root) / name
        make_new_folder(folder)
        try:
            sync_folder(Path(root))
            return cls(folder, name, created, software)
        except (OSError, DiskFullError) as error:
            shutil.rmtree(folder, ignore_errors=True)
            if isinstance(error, OSError):
                raise disk_error(error, folder) from error
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
            write_atomic(self.folder / PLAN, indented(encode_checked(plan, BurstPlan)))
            if self.plan is None:
                reserve_room(self.folder, plan)
            self.plan = plan

    def add_image(
        self, data: bytes, *, camera: str, instant: int, leader_ns: int, suffix: str = ".jpg", **further: Any
    ) -> ImageRecord:
        """Save one image's file bytes as they are; once this returns no crash can lose it.

        `further` are the fields of its ImageRecord that are known. Raises BadInputError for an unsafe camera
        name, an unknown kind of file, an empty image, or an image that the session has already.
        """
        image = new_image(data, camera=camera, instant=instant, leader_ns=leader_ns, suffix=suffix, **further)
        with self._writing():
            self._images.begin(image)
        for error in self._images.save([image]):
            if error is not None:
                raise disk_error(error, self.folder) from error
        return image.record

    def add_received(self, images: Sequence[ReceivedImage]) -> list[SimulshotError | None]:
        """Add images that were received into files on this disk and checked against their records.

        Each file is moved into its place; once this returns no crash can lose one, unless it has an error
        in the answer. The disk is synced once for all of them.
        """
        outcome: list[SimulshotError | None] = [None] * len(images)
        begun: dict[int, NewImage] = {}
        for place, image in enumerate(images):
            try:
                with self._writing():
                    begun[place] = self._begin(image)
            except SimulshotError as error:
                outcome[place] = error
        for place, failure in zip(begun, self._images.save(list(begun.values())), strict=True):
            outcome[place] = None if failure is None else disk_error(failure, self.folder)
        return outcome

    def add_frames(self, frames: Sequence[NewFrame]) -> None:
        """Add frames to the video of their one camera, all of them, or none and a SimulshotError."""
        try:
            with self._mutex:
                self._check_open()
            self.videos.add(frames)
        except OSError as error:
            raise disk_error(error, self.folder) from error

    @property
    def damaged(self) -> tuple[tuple[str, int], ...]:
        """Images of a resumed session, by camera and instant, that were saved and are damaged now."""
        return self._images.damaged

    def image(self, camera: str, instant: int) -> ImageRecord | None:
        """The record of an image that is saved already; None where it is not."""
        return self._images.get(camera, instant) or self.videos.frame(camera, instant)

    def instants_of(self, camera: str) -> InstantSet:
        """The instants of which a camera's image is saved."""
        return InstantSet([*self._images.instants(camera), *self.videos.instants(camera)])

    def add_event(self, *events: Mapping[str, Any]) -> None:
        """Append what the engine saw or did to events.ndjson."""
        with self._writing():
            self._events.append(*(msgspec.json.encode(event) for event in events), durable=False)

    def add_ground_truth(self, camera: str, instant: int, data: bytes | None, true_ns: int) -> None:
        """Save the .npz of a simulated image and its true first-row time in ns of the host's clock.

        `data` is None where there is no .npz, only the time.
        """
        check_name(camera, "camera")
        with self._writing():
            self._images.sync(self._add_truth(camera, instant, data, true_ns))

    @property
    def knows_true_times(self) -> bool:
        """Whether any image came with its true time, as simulated ones do."""
        return self._truth.knows_times or self.videos.knows_true_times

    def set_ground_truth_clocks(self, clocks: Mapping[str, SimulatedClock]) -> None:
        """Keep each simulated camera's clock as it really is."""
        self._truth.set_clocks(clocks)

    def set_calibration(self, calibration: Calibration) -> None:
        """Save the rig's calibration. Raises BadInputError where it holds what JSON cannot (NaN)."""
        with self._writing():
            write_atomic(self.folder / CALIBRATION, indented(encode_checked(calibration, Calibration)))

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
            self._images.wait_for_all()
            gone = (gap for gap in missing if not self._has(gap.camera, gap.instant))
            manifest = Manifest(
                name=self.name,
                created=self.created,
                origin=origin,
                software=self.software,
                cameras=tuple(cameras),
                burst=burst,
                images=self._images.records,
                missing=tuple(sorted(gone, key=lambda m: (m.instant, m.camera))),
                note=earlier_note(self.folder) or note,
                videos=self.videos.records(),
            )
            data = encode_manifest(self.folder, manifest, self.videos.in_order(burst.instants_ns))
            remove_leftovers(self.folder)
            write_manifest(self.folder, data, (*self._truth.write(), self.folder / EVENTS))
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
            self.plan = read_plan(self.folder)
        interrupted = self.plan is not None or (self.folder / JOURNAL).exists()
        self._images.open(recover=interrupted)
        if interrupted:
            self.videos.recover()
            self._truth.recover(self._images.records)

    def _begin(self, image: ReceivedImage) -> NewImage:
        record, line = image.record, image.journal_line()
        truth: tuple[Path, ...] = ()
        if image.true_ns is not None:
            truth = self._add_truth(record.camera, record.instant, image.truth or None, image.true_ns)
        new = NewImage(record, line, image.file.replace, truth)
        self._images.begin(new)
        return new

    def _add_truth(self, camera: str, instant: int, data: bytes | None, true_ns: int) -> tuple[Path, ...]:
        return self._truth.add(camera, instant, true_ns, data=data, crash_safe=self.plan is not None)

    @contextmanager
    def _writing(self) -> Iterator[None]:
        with self._mutex:
            self._check_open()
            try:
                yield
            except OSError as error:
                raise disk_error(error, self.folder) from error

    def _has(self, camera: str, instant: int) -> bool:
        return self._images.get(camera, instant) is not None or self.videos.has(camera, instant)

    def _check_open(self) -> None:
        if not self._open:
            raise BadInputError(f"{self.folder} is closed: nothing can be added any more")

    def _close(self) -> None:
        self._images.wait_for_all()
        self.videos.close()
        self._open = False
        # All saved images are synced already: an error here loses none.
        self._images.close()
        with suppress(OSError):
            self._events.close(synced=False)
        self._truth.close()
        os.close(self._lock)
