"""What a node has of a burst on its way to the leader: frames, encoded images, a folder in the spool."""

import hashlib
from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from msgspec.structs import replace

from capture_app.cameras.base import CapturedFrame
from capture_app.errors import CameraError
from capture_app.node.camera.spool import SpooledBurst
from capture_app.node.wire.messages import CameraReport, ImageUpload
from capture_app.session.files.disk import disk_error
from capture_app.session.format.burst_plan import MissingRun
from capture_app.session.format.manifest import ImageRecord, MissingImage, image_path
from capture_app.sync.rig.frame_selection import RING_BYTES, SelectedFrame

TOO_SLOW = "the node could not save its frames as fast as they came"


def encode_frame(
    report: CameraReport, picked: SelectedFrame[CapturedFrame], *, with_truth: bool = True
) -> tuple[ImageUpload, bytes]:
    """Return an image's header and its bytes, ground truth behind them. Raises CameraError."""
    frame = picked.frame
    try:
        image = frame.picture.encode()
        truth = b"" if frame.truth is None or not with_truth else frame.truth.encode()
    except Exception as error:
        # Drivers and encoders raise what they like; one bad frame must not end the node.
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
        uncertainty_ns=picked.uncertainty_ns,
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
        true_ns=None if frame.truth is None else frame.truth.true_ns,
        truth_sha256=hashlib.sha256(truth).hexdigest() if truth else None,
    )
    return upload, image + truth


@dataclass(slots=True)
class BurstUpload:
    """A burst's frames on their way to the leader: picked, then encoded, then confirmed."""

    report: CameraReport
    """Its instants are those that were ordered; the leader may want fewer."""
    frames: deque[SelectedFrame[CapturedFrame]]
    images: deque[ImageUpload] = field(default_factory=deque)
    """Ready to send as often as it takes."""
    in_memory: dict[int, bytes] = field(default_factory=dict)
    """By instant, the bytes of those images that are not safely in the spool."""
    unsynced: dict[int, ImageUpload] = field(default_factory=dict)
    """By instant, those that are written to the spool but not on its disk yet."""
    confirmed: set[int] = field(default_factory=set)
    """Instants that the leader has."""
    disputed: list[ImageUpload] = field(default_factory=list)
    """Images of which the leader has others in their places: they are not sent, and not deleted."""
    spooled: SpooledBurst | None = None
    spooling: bool = True
    """Whether the spool is to be used; False once it could not be."""
    is_committed: bool = False
    """Whether the leader has said which instants it wants."""
    wanted: frozenset[int] | None = None
    """The instants that the leader wants; None for all."""
    is_over: bool = False
    """Nothing of it is to be sent any more: the leader has it, or does not want it."""
    on_commit: Callable[[], None] = lambda: None
    """Called when no further instants are wanted."""
    streamed: bool = False
    """The frames are sent as they are picked."""
    video: bool = False
    """They go into a video, which has no ground truth but their times."""
    most_bytes: int = RING_BYTES
    """The most memory that streamed frames may take that are not on a disk yet: the camera goes on."""
    over: int = 0
    """How many instants of a streamed burst are decided."""
    ended: bool = False
    """Nothing more of it is picked."""
    missing_runs: list[MissingRun] = field(default_factory=list)
    """Which of its instants are missing."""
    end_is_kept: bool = False
    """Whether the spool has what is known at its end."""

    @property
    def is_picking(self) -> bool:
        """Whether further frames will be picked."""
        return self.streamed and not self.ended

    @property
    def has_work(self) -> bool:
        """Whether there is something to tell or to send."""
        return not self.is_picking or bool(self.images) or not self.is_committed

    def report_now(self) -> CameraReport:
        """The report as it stands now."""
        return self.report_to_keep(tuple(image.record.instant for image in self.images))

    def report_to_keep(self, waiting: tuple[int, ...] = ()) -> CameraReport:
        """The report as the spool has it, which has the images beside it.

        Of a streamed burst those instants are told whose images are `waiting`.
        """
        if not self.streamed:
            return self.report
        told = self.report.with_plan(instants=waiting, picking=not self.ended, missing=())
        runs = tuple(self.missing_runs)
        return told.with_plan(picked=self.over, missing_runs=runs) if self.ended else told

    def load(self, image: ImageUpload) -> bytes | None:
        """An image's bytes; None where the spool does not have them as they were.

        Raises DiskError where its disk cannot be read at present.
        """
        if image.record.instant in self.in_memory:
            return self.in_memory[image.record.instant]
        assert self.spooled is not None
        try:
            data = self.spooled.image_file(image).read_bytes()
        except FileNotFoundError:
            return None
        except OSError as error:
            raise disk_error(error, self.spooled.folder) from error
        record = image.record
        whole = len(data) == record.bytes + image.truth_bytes
        return data if whole and hashlib.sha256(data[: record.bytes]).hexdigest() == record.sha256 else None

    def extend(
        self,
        frames: Iterable[SelectedFrame[CapturedFrame]],
        missing: Iterable[MissingImage],
        *,
        over: int = 0,
        ended: bool = False,
    ) -> None:
        """Add what was picked for further instants, unless the leader does without them.

        Of a burst whose frames are sent as they are picked, `over` instants are decided now; with `ended`
        these are all.
        """
        if self.streamed:
            self.over = max(self.over, over)
            for gap in missing:
                self._note_missing(gap.instant, gap.reason, dropped=gap.dropped)
            self._add_frames(frames)
            if ended and not self.ended:
                self.ended = True
                self.report = replace(self.report)
            return
        if self.is_committed or self.is_over:
            return
        new = [*frames]
        self.frames.extend(new)
        instants = (*self.report.plan.instants, *(frame.instant for frame in new))
        self.report = self.report.with_plan(instants=instants, missing=(*self.report.plan.missing, *missing))

    def commit(self, wanted: Collection[int] | None) -> list[Path]:
        """Keep only what the leader wants, None for all; return the files of the rest."""
        first, self.is_committed = not self.is_committed, True
        self.wanted = None if wanted is None else frozenset(wanted)
        if first:
            self.on_commit()
        if wanted is None:
            return []
        self.frames = deque(frame for frame in self.frames if frame.instant in wanted)
        return self._let_go(lambda instant: instant not in wanted)

    def reopen(self) -> None:
        """Begin anew with another stream: the leader may be another one, or have changed its mind."""
        self.is_committed = False
        self.images.extend(self.disputed)
        self.disputed.clear()

    def confirm(self, stored: Mapping[int, str]) -> list[Path]:
        """Let go of images that the leader has, by instant and checksum; return their files.

        An image that it has another one in the place of is disputed.
        """
        if not self.streamed:
            self.confirmed.update(stored)
        for image in tuple(self.images):
            if stored.get(image.record.instant, image.record.sha256) != image.record.sha256:
                self.images.remove(image)
                self.disputed.append(image)
        return self._let_go(lambda instant: instant in stored)

    def end(self) -> None:
        """Let go of all of it."""
        self.is_over = True
        self.frames.clear()
        self._let_go(lambda _: True)

    def lost_instants(self) -> list[int]:
        """The instants that are wanted of what was announced, and are neither here nor with the leader."""
        if self.streamed:
            return []
        here = {image.record.instant for image in self.images} | {frame.instant for frame in self.frames}
        announced = frozenset(self.report.plan.instants)
        wanted = announced if self.wanted is None else self.wanted & announced
        return sorted(wanted - here - self.confirmed)

    def report_lost(self, instants: Collection[int], reason: str) -> None:
        """Move announced images that will not come to those that are missing."""
        if self.streamed:
            for instant in instants:
                self._note_missing(instant, reason)
            if self.ended:
                self.report = replace(self.report)
            return
        plan = self.report.plan
        name = plan.camera.name
        gone = tuple(MissingImage(camera=name, instant=instant, reason=reason) for instant in instants)
        left = tuple(instant for instant in plan.instants if instant not in instants)
        self.report = self.report.with_plan(instants=left, missing=(*plan.missing, *gone))

    def _add_frames(self, frames: Iterable[SelectedFrame[CapturedFrame]]) -> None:
        """Take those frames that there is memory for; others are missing."""
        held_bytes = sum(map(len, list(self.in_memory.values())))
        held_bytes += sum(waiting.frame.picture.held_bytes for waiting in self.frames)
        for frame in frames:
            size = frame.frame.picture.held_bytes
            if held_bytes + size > self.most_bytes:
                self._note_missing(frame.instant, TOO_SLOW)
                continue
            held_bytes += size
            self.frames.append(frame)

    def _note_missing(self, instant: int, reason: str, *, dropped: bool = False) -> None:
        last = self.missing_runs[-1] if self.missing_runs else None
        follows = last is not None and last.first + last.count == instant
        if last is not None and follows and (last.reason, last.dropped) == (reason, dropped):
            self.missing_runs[-1] = replace(last, count=last.count + 1)
        else:
            self.missing_runs.append(MissingRun(first=instant, count=1, reason=reason, dropped=dropped))

    def _let_go(self, of: Callable[[int], bool]) -> list[Path]:
        gone = [image for image in self.images if of(image.record.instant)]
        for image in gone:
            self.images.remove(image)
            self.in_memory.pop(image.record.instant, None)
            self.unsynced.pop(image.record.instant, None)
        return [] if self.spooled is None else [self.spooled.image_file(image) for image in gone]
