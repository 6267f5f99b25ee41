"""A burst on its node, on its way to the leader: frames, encoded images, and a folder in the spool.

SPOOL/<camera>/<leader>-<burst>/
  report.json       the node's report of the burst, as sent to the leader
  <number>.film     its images: see `film_spool`
"""

import hashlib
import itertools
import os
import threading
from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

import msgspec
from msgspec.structs import replace

from capture_app.cameras.frames import CapturedFrame
from capture_app.common.bounds import cut
from capture_app.common.errors import (
    BadInputError,
    CameraError,
    DiskError,
    DiskFullError,
    SimulshotError,
    TryAgainError,
)
from capture_app.common.names import check_name
from capture_app.node.camera.film_spool import SpooledFilm
from capture_app.protocol.messages import MAX_BATCH_IMAGES, CameraReport, ImageUpload, SpoolSpace
from capture_app.session.files.disk import LITTLE_BYTES, disk_error, disk_errors, free_bytes, reserve
from capture_app.session.files.durable import PART, make_folders, sync_all, write_atomic
from capture_app.session.files.locks import lock_folder
from capture_app.session.files.untrusted_files import read_struct
from capture_app.session.format.burst_plan import MissingRun
from capture_app.session.format.manifest import (
    MAX_WIDENED,
    ImageRecord,
    MissingImage,
    WidenedTimes,
    image_path,
)
from capture_app.sync.rig.frame_selection import DROPPED, RING_BYTES, FramesSelected, SelectedFrame

REPORT = "report.json"
UNKNOWN_ROOM = 1 << 30
"""Free space to report, in bytes, while memory replaces the spool."""
BATCH_BYTES = 2 << 20
"""Length of the batches in which images are sent; a larger image is a batch of its own."""
TOO_SLOW = "the node could not store its frames as fast as the camera delivered them"


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

        Raises BadInputError if it is missing or damaged.
        """
        return read_struct(self.folder / REPORT, CameraReport)

    def remove(self) -> bool:
        """Delete the burst, once the leader has all of it; return whether the disk has done so."""
        with self._changing:
            self._is_removed = True
            self.film.close()
            # The report goes last: without it, a restarted node would not find what is left.
            with suppress(OSError):
                for file in sorted(self.folder.iterdir(), key=lambda file: file.name == REPORT):
                    file.unlink()
                self.folder.rmdir()
            return not self.folder.exists()


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

    def open(self) -> list[SpoolFolder]:
        """Lock the spool and return the bursts in it, oldest first.

        Raises SimulshotError where it cannot be written, TryAgainError where another node uses it.
        """
        try:
            make_folders(self.folder, Path(self.folder.anchor))
            self._lock = lock_folder(self.folder)
            self.adopt()
            folders = list(self.folder.iterdir())
            bursts = [folder for folder in folders if (folder / REPORT).is_file()]
            for folder in (folder for folder in folders if folder not in bursts):
                # The node was stopped while it made or removed the folder. One with images stays.
                with suppress(OSError):
                    (folder / f"{REPORT}{PART}").unlink(missing_ok=True)
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
            if root == self._root:
                continue
            with suppress(SimulshotError, OSError):
                lock = lock_folder(root / self.camera)
                try:
                    for report in (root / self.camera).glob(f"*/{REPORT}"):
                        folder = self.folder / report.parent.name
                        if folder.name not in under_way and not folder.exists():
                            report.parent.rename(folder)
                            moved.append(SpoolFolder(folder))
                finally:
                    os.close(lock)
        return moved

    def create_burst(self, report: CameraReport) -> SpoolFolder:
        """Create a burst's folder with its report; `SpoolFolder.sync` secures both against a power cut.

        Raises DiskFullError, SimulshotError.
        """
        burst = SpoolFolder(self.folder / folder_name(report))
        try:
            burst.folder.mkdir(exist_ok=True)
            write_atomic(burst.folder / REPORT, msgspec.json.encode(report), synced=False)
        except OSError as error:
            burst.remove()
            raise disk_error(error, self.folder) from error
        return burst

    def remove(self, burst: SpoolFolder) -> None:
        """Delete a burst, now or when its disk can do so again."""
        if not burst.remove():
            self._left.append(burst)

    def look(self) -> SpoolSpace:
        """Return the free space, and the reason if the spool cannot be used; delete what could not be before.

        Blocks on the disk.
        """
        space = SpoolSpace(camera=self.camera, free_bytes=0, spool=str(self.folder))
        probe = self.folder / f"probe{PART}"
        try:
            with disk_errors(self.folder):
                reserve(probe, LITTLE_BYTES)
                probe.unlink()
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


def encode_frame(
    report: CameraReport, picked: SelectedFrame[CapturedFrame], *, with_truth: bool = True
) -> tuple[ImageUpload, bytes]:
    """Return an image's header and its bytes followed by the ground truth. Raises CameraError."""
    frame = picked.frame
    try:
        image = frame.picture.encode()
        truth = frame.encode_truth() if with_truth and frame.encode_truth else b""
    except Exception as error:
        # Drivers and encoders raise arbitrary exceptions; one bad frame must not end the node.
        raise CameraError(f"the frame could not be encoded: {error}") from error
    camera, name = report.plan.camera, report.plan.camera.name
    record = ImageRecord(
        camera=name,
        instant=picked.instant,
        path=image_path(name, picked.instant),
        leader_ns=picked.leader_ns,
        bytes=len(image),
        sha256=hashlib.sha256(image).hexdigest(),
        local_ns=picked.local_ns,
        residual_ns=picked.residual_ns,
        uncertainty_ns=picked.uncertainty_ns + frame.clock_uncertainty_ns,
        hard_bound_ns=picked.hard_bound_ns,
        exposure_start_ns=camera.facts.exposure_start_ns(picked.stamp_leader_ns, frame.exposure_ns),
        exposure_ns=frame.exposure_ns,
        gain=frame.gain,
        white_balance=frame.white_balance,
        sequence=frame.sequence,
        outlier_ns=picked.outlier_ns,
        alignment_offset_ns=picked.alignment_offset_ns,
        late=camera.is_late(picked.residual_ns),
    )
    upload = ImageUpload(
        leader=report.leader,
        burst=report.burst,
        record=record,
        truth_bytes=len(truth),
        true_ns=frame.true_ns,
        truth_sha256=hashlib.sha256(truth).hexdigest() if truth else None,
    )
    return upload, image + truth


def is_intact(image: ImageUpload, data: bytes) -> bool:
    """Return whether these are an image's bytes."""
    return hashlib.sha256(memoryview(data)[: image.record.bytes]).hexdigest() == image.sha256


@dataclass(slots=True)
class Upload:
    """A burst's frames on their way to the leader: selected, then encoded, then confirmed."""

    report: CameraReport
    """Lists the ordered instants; the leader may request fewer."""
    frames: deque[SelectedFrame[CapturedFrame]] = field(default_factory=deque)
    images: dict[int, ImageUpload] = field(default_factory=dict)
    """Encoded images, which can be sent as often as needed, by instant, in the order of sending."""
    in_memory: dict[int, bytes] = field(default_factory=dict)
    """Bytes of the images that are not safely in the spool, by instant."""
    unsynced: dict[int, ImageUpload] = field(default_factory=dict)
    """Images that are written to the spool but not synced to its disk yet, by instant."""
    confirmed: set[int] = field(default_factory=set)
    """Instants that the leader has."""
    disputed: list[ImageUpload] = field(default_factory=list)
    """Images in whose place the leader has others: they are neither sent nor deleted."""
    spooled: SpoolFolder | None = None
    spooling: bool = True
    """Whether to use the spool; False once that has failed."""
    oldest: tuple[int, float] = (-1, 0.0)
    """The instant that is unsynced for longest, and since when at least, by the event loop's time."""
    is_committed: bool = False
    """Whether the leader has named the instants that it requests."""
    reported: CameraReport | None = None
    """The `report` that was last sent over the present stream."""
    due_s: float = 0.0
    """Time of the event loop at which to report again a burst that is not committed."""
    attempts: int = 0
    """Number of reports in a row that did not commit the burst."""
    is_doubted: bool = False
    """Whether it has ever been refused for now, perhaps because an image is damaged."""
    requested: frozenset[int] | None = None
    """The instants that the leader requests; None for all."""
    end_instant: int | None = None
    """Of a streamed burst: the number of instants that the leader needs."""
    is_over: bool = False
    """Whether sending is over: the leader has the burst, or does not want it."""
    on_commit: Callable[[], None] = lambda: None
    """Called when no further instants are requested."""
    streamed: bool = False
    """Whether frames are sent as they are selected."""
    with_truth: bool = True
    """Whether a simulated image's ground truth is sent: a video has only its times."""
    max_bytes: int = RING_BYTES
    """Maximum memory for streamed frames that are not on a disk yet, as the camera keeps delivering."""
    over: int = 0
    """Number of instants of a streamed burst that are decided."""
    ended: bool = False
    """Whether the selection of frames has ended."""
    missing_runs: list[MissingRun] = field(default_factory=list)
    """Its missing instants, as runs."""
    end_is_stored: bool = False
    """Whether the spool has the final report of a streamed burst."""

    @classmethod
    def of_spool(cls, spooled: SpoolFolder) -> Self:
        """Return a burst that an earlier run of the node left in the spool. Raises SimulshotError."""
        report = spooled.read_report()
        images = {image.record.instant: image for image in spooled.film.recover()}
        here, plan = {*images}, report.plan
        if not plan.picking and plan.picked is None:
            # Of frames that are sent as they are selected, the leader has all that are no longer here.
            here |= {*plan.instants}
        missing = tuple(gap for gap in plan.missing if gap.instant not in here)
        report = report.with_plan(instants=tuple(sorted(here)), missing=missing, picking=False)
        return cls(report, images=images, spooled=spooled, ended=True, end_is_stored=True)

    def continue_from(self, left: "Upload") -> None:
        """Take over what an earlier run of the node has left of the same streamed burst."""
        self.images, self.spooled, self.disputed = left.images, left.spooled, left.disputed
        self.is_doubted = True

    @property
    def is_left(self) -> bool:
        """Whether an earlier run of the node left it in the spool."""
        return self.ended and not self.streamed

    @property
    def is_picking(self) -> bool:
        """Whether further frames will be selected."""
        return self.streamed and not self.ended

    @property
    def has_ended(self) -> bool:
        """Whether nothing more will be sent."""
        is_told = self.is_committed and self.reported is self.report
        return self.is_over or (is_told and not (self.is_picking or self.frames or self.images))

    def must_be_reported(self, now_s: float) -> bool:
        """Return whether the leader has to know the report, or to be asked again, at that time."""
        return self.reported is not self.report or (not self.is_committed and now_s >= self.due_s)

    def put_off(self, due_s: float) -> None:
        """Send nothing of the burst before `due_s`, unless its report changes."""
        self.is_committed, self.due_s, self.attempts = False, due_s, self.attempts + 1
        self.is_doubted = True

    def current_report(self, waiting: tuple[int, ...] = ()) -> CameraReport:
        """Return the report as it is now.

        For a streamed burst it lists the instants whose images are `waiting`: for the leader those that are
        `encoded`; for the spool, which stores the images beside it, none.
        """
        if not self.streamed:
            return self.report
        decided = {"picked": self.over, "missing_runs": tuple(self.missing_runs)} if self.ended else {}
        return self.report.with_plan(instants=waiting, picking=not self.ended, missing=(), **decided)

    def load(self, images: Sequence[ImageUpload]) -> list[bytes | None]:
        """Return each image's bytes; None if the spool no longer has them unchanged.

        The leader checks what it receives: images are checked here only if this burst was refused before, or
        if an earlier run has left it. Raises DiskError where the disk cannot be read at present.
        """
        stored = [image for image in images if image.record.instant not in self.in_memory]
        found = dict(self.in_memory)
        if stored and self.spooled is not None:
            for image, data in zip(stored, self.spooled.film.read(stored), strict=True):
                if data is not None and (self._is_trusted or is_intact(image, data)):
                    found[image.record.instant] = data
        return [found.get(image.record.instant) for image in images]

    @property
    def _is_trusted(self) -> bool:
        return self.streamed and not self.is_doubted

    def extend(self, picked: FramesSelected[CapturedFrame]) -> None:
        """Add frames selected for further instants, unless the leader does not need them.

        Frames of a streamed burst that do not fit into memory are missing.
        """
        if self.ended or (not self.streamed and (self.is_committed or self.is_over)):
            return
        for gap in picked.gaps:
            self._note_missing(gap.instant, gap.reason, dropped=gap.reason == DROPPED)
        if not self.streamed:
            self.frames.extend(picked.frames)
            self.report = self.report.with_plan(
                instants=(*self.report.plan.instants, *(frame.instant for frame in picked.frames))
            )
            return
        self.over = max(self.over, picked.over)
        held_bytes = sum(map(len, list(self.in_memory.values())))
        held_bytes += sum(waiting.frame.picture.held_bytes for waiting in self.frames)
        for frame in filter(lambda of: self._is_needed(of.instant), picked.frames):
            if held_bytes + frame.frame.picture.held_bytes > self.max_bytes:
                self._note_missing(frame.instant, TOO_SLOW)
            else:
                held_bytes += frame.frame.picture.held_bytes
                self.frames.append(frame)
        if picked.ended:
            self.ended = True
            self.report = replace(self.report)

    def widen_times(self, times: WidenedTimes) -> None:
        """Report that a clock was wrong in an interval; beyond MAX_WIDENED the last interval grows."""
        camera = self.report.plan.camera
        known = camera.widened
        if len(known) == MAX_WIDENED:
            known, last = known[:-1], known[-1]
            times = replace(
                times,
                from_local_ns=min(last.from_local_ns, times.from_local_ns),
                uncertainty_ns=max(last.uncertainty_ns, times.uncertainty_ns),
                hard_bound_ns=max(last.hard_bound_ns, times.hard_bound_ns),
            )
        self.report = self.report.with_plan(camera=replace(camera, widened=(*known, times)))

    def commit(self, requested: Collection[int] | None, end: int | None = None) -> list[Path]:
        """Restrict the upload to the `requested` instants before `end` (None: all); return the dropped files.

        A streamed burst has an `end`, which its operator may have moved while this node was not reached.
        """
        first, self.is_committed = not self.is_committed, True
        self.requested, self.end_instant = None if requested is None else frozenset(requested), end
        if first and not self.streamed:
            self.on_commit()
        dropped = {
            instant
            for instant in (*self.encoded, *(frame.instant for frame in self.frames))
            if not self._is_needed(instant)
        }
        if dropped:
            self.frames = deque(frame for frame in self.frames if frame.instant not in dropped)
        return self._let_go(dropped)

    def _is_needed(self, instant: int) -> bool:
        is_requested = self.requested is None or instant in self.requested
        return is_requested and (self.end_instant is None or instant < self.end_instant)

    def reopen(self) -> None:
        """Reset for a new stream: the leader may be another one, or have changed its mind."""
        self.is_committed, self.reported, self.attempts = False, None, 0
        self.images |= {image.record.instant: image for image in self.disputed}
        self.disputed.clear()

    def confirm(self, stored: Mapping[int, str]) -> list[Path]:
        """Drop images that the leader has, given as checksums by instant; return their files.

        An image in whose place the leader has another one becomes disputed.
        """
        if not self.streamed:
            self.confirmed.update(stored)
        for instant, sha256 in stored.items():
            if instant in self.images and self.images[instant].sha256 != sha256:
                self.disputed.append(self.images.pop(instant))
        return self._let_go(stored)

    def end(self) -> None:
        """Drop the whole burst: its frames, images and report."""
        self.is_over = True
        self.frames.clear()
        self._let_go(self.encoded)

    def lost_instants(self) -> list[int]:
        """Return the requested instants that were announced, and are neither here nor with the leader."""
        here = {*self.encoded, *(frame.instant for frame in self.frames)}
        return sorted(filter(self._is_needed, {*self.report.plan.instants} - here - self.confirmed))

    def report_lost(self, instants: Collection[int], reason: str) -> list[Path]:
        """Report announced images that will not come as missing, and drop them; return their files."""
        for instant in instants:
            self._note_missing(instant, cut(reason))
        if not self.streamed or self.ended:
            left = tuple(instant for instant in self.report.plan.instants if instant not in instants)
            self.report = self.report.with_plan(instants=left)
        return self._let_go(instants)

    @property
    def encoded(self) -> tuple[int, ...]:
        """Instants of the encoded images that are here."""
        return tuple(self.images)

    def next_batch(self, sent: int) -> list[ImageUpload]:
        """Return the images to send after the first `sent` ones."""
        batch: list[ImageUpload] = []
        size = 0
        for image in itertools.islice(self.images.values(), sent, sent + MAX_BATCH_IMAGES):
            size += image.bytes
            if batch and size > BATCH_BYTES:
                break
            batch.append(image)
        return batch

    def _note_missing(self, instant: int, reason: str, *, dropped: bool = False) -> None:
        if not self.streamed:
            gap = MissingImage(camera=self.report.camera, instant=instant, reason=reason, dropped=dropped)
            self.report = self.report.with_plan(missing=(*self.report.plan.missing, gap))
            return
        run = MissingRun(first=instant, count=1, reason=reason, dropped=dropped)
        # A frame can turn out to be missing after later ones, when it is encoded or sent.
        place = bisect_left(self.missing_runs, instant, key=lambda run: run.first)
        last = self.missing_runs[place - 1] if place else run
        if replace(run, first=last.first, count=instant - last.first) == last:
            self.missing_runs[place - 1] = replace(last, count=last.count + 1)
        else:
            self.missing_runs.insert(place, run)

    def _let_go(self, instants: Collection[int]) -> list[Path]:
        dropped = [self.images.pop(instant) for instant in instants if instant in self.images]
        for image in dropped:
            self.in_memory.pop(image.record.instant, None)
            self.unsynced.pop(image.record.instant, None)
        if self.spooled is None:
            return []
        return self.spooled.film.release([image.record.instant for image in dropped])
