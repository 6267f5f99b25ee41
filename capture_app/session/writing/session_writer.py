"""Writes a session so that a crash at any moment loses at most the image being written."""

import os
import shutil
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Self

import msgspec

from capture_app import __version__
from capture_app.clock import SimulatedClock
from capture_app.errors import BadInputError, DiskFullError, SimulshotError
from capture_app.names import check_name
from capture_app.session.files.disk import disk_error, make_new_folder
from capture_app.session.files.durable import (
    AppendOnlyFile,
    sync_folder,
    write_atomic,
)
from capture_app.session.files.locks import lock_folder
from capture_app.session.format.burst_plan import PLAN, BurstPlan, read_plan
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.checks import encode_checked, indented
from capture_app.session.format.manifest import (
    CALIBRATION,
    EVENTS,
    JOURNAL,
    BurstRecord,
    CameraRecord,
    ImageRecord,
    Manifest,
    MissingImage,
)
from capture_app.session.reading.reader import Session
from capture_app.session.writing.completion import earlier_note, encode_manifest, reserve_room, write_manifest
from capture_app.session.writing.image_store import ImageStore, NewImage, new_image
from capture_app.session.writing.instant_set import InstantSet
from capture_app.session.writing.received_image import ReceivedImage
from capture_app.session.writing.recovery import remove_leftovers
from capture_app.session.writing.truth_store import TruthStore
from capture_app.session.writing.video_store import NewFrame, VideoStore


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
