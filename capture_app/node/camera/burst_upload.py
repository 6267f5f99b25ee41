"""A burst on its node, on its way to the leader: frames, encoded images, and what the leader has of them."""

import hashlib
import itertools
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any, Self

from msgspec.structs import replace

from capture_app.cameras.frames import CapturedFrame
from capture_app.common.bounds import cut
from capture_app.common.errors import (
    CameraError,
)
from capture_app.node.camera.spool import SpoolFolder
from capture_app.protocol.messages import MAX_BATCH_IMAGES, CameraReport, ImageUpload
from capture_app.session.format.burst_plan import MissingRun
from capture_app.session.format.manifest import (
    MAX_WIDENED,
    ImageRecord,
    MissingImage,
    WidenedTimes,
    image_path,
)
from capture_app.sync.rig.frame_selection import DROPPED, RING_BYTES, FramesSelected, SelectedFrame

BATCH_BYTES = 2 << 20
"""Length of the batches in which images are sent; a larger image is a batch of its own."""
TOO_SLOW = "the node could not store its frames as fast as the camera delivered them"
NO_SPOOL = "its node's spool could not be written, and its memory was full"


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


class UploadState(Enum):
    """What the leader knows of a burst over the present stream."""

    UNREPORTED = "nothing"
    ASKED = "its report; the answer is awaited"
    OUTDATED = "an earlier report; the present one is sent before further images"
    WAITING = "its report, which is sent again at `Upload.due_s`"
    SENDING = "its report, and it has named the instants that it needs: images are sent"
    REFUSED = "that it does not take it, which another leader may"
    OVER = "all of it, or that it was cancelled"


UploadInput = Enum("UploadInput", "OPENED REPORTED CHANGED PUT_OFF REQUESTED REFUSED ENDED")
"""What happens to a burst: a stream to offer it over was opened; its report was sent, or changed; the leader
cannot take it yet, requests instants, or refuses it; it was cancelled, or is complete."""
_S, _I = UploadState, UploadInput
TRANSITIONS = {
    (_S.UNREPORTED, _I.OPENED): _S.UNREPORTED,
    (_S.UNREPORTED, _I.CHANGED): _S.UNREPORTED,
    (_S.UNREPORTED, _I.REPORTED): _S.ASKED,
    (_S.UNREPORTED, _I.ENDED): _S.OVER,
    (_S.ASKED, _I.OPENED): _S.UNREPORTED,
    (_S.ASKED, _I.CHANGED): _S.OUTDATED,
    (_S.ASKED, _I.PUT_OFF): _S.WAITING,
    (_S.ASKED, _I.REQUESTED): _S.SENDING,
    (_S.ASKED, _I.REFUSED): _S.REFUSED,
    (_S.ASKED, _I.ENDED): _S.OVER,
    (_S.OUTDATED, _I.OPENED): _S.UNREPORTED,
    (_S.OUTDATED, _I.CHANGED): _S.OUTDATED,
    (_S.OUTDATED, _I.REPORTED): _S.ASKED,
    # Answers to the earlier report, or to images that were sent before it changed.
    (_S.OUTDATED, _I.PUT_OFF): _S.OUTDATED,
    (_S.OUTDATED, _I.REQUESTED): _S.OUTDATED,
    (_S.OUTDATED, _I.REFUSED): _S.REFUSED,
    (_S.OUTDATED, _I.ENDED): _S.OVER,
    (_S.WAITING, _I.OPENED): _S.UNREPORTED,
    (_S.WAITING, _I.CHANGED): _S.OUTDATED,
    (_S.WAITING, _I.REPORTED): _S.ASKED,
    # Answers to images that were sent before one of them was refused.
    (_S.WAITING, _I.PUT_OFF): _S.WAITING,
    (_S.WAITING, _I.REFUSED): _S.REFUSED,
    (_S.WAITING, _I.ENDED): _S.OVER,
    (_S.SENDING, _I.OPENED): _S.UNREPORTED,
    (_S.SENDING, _I.CHANGED): _S.OUTDATED,
    (_S.SENDING, _I.PUT_OFF): _S.WAITING,
    (_S.SENDING, _I.REFUSED): _S.REFUSED,
    (_S.SENDING, _I.ENDED): _S.OVER,
    (_S.REFUSED, _I.OPENED): _S.UNREPORTED,
    (_S.REFUSED, _I.CHANGED): _S.REFUSED,
    (_S.REFUSED, _I.ENDED): _S.OVER,
    # Its operator may cancel it at any time, so that any answer may come after its end.
    **{(_S.OVER, event): _S.OVER for event in _I},
}
"""State after an input in each state; what is not here cannot happen."""


@dataclass(slots=True, eq=False)
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
    state: UploadState = UploadState.UNREPORTED
    due_s: float = 0.0
    """Time of the event loop at which to report again a burst that waits."""
    attempts: int = 0
    """Number of times in a row that it waited, without an image that was saved in between."""
    is_doubted: bool = False
    """Whether it has ever been refused for now, perhaps because an image is damaged."""
    requested: frozenset[int] | None = None
    """The instants that the leader requests; None for all."""
    end_instant: int | None = None
    """Of a streamed burst: the number of instants that the leader needs."""
    on_commit: Callable[[], None] = lambda: None
    """Called when the leader has named its instants, so that no further ones are selected; perhaps again."""
    streamed: bool = False
    """Whether frames are sent as they are selected."""
    with_truth: bool = True
    """Whether a simulated image's ground truth is sent: a video has only its times."""
    max_bytes: int = RING_BYTES
    """Maximum memory for streamed frames that are not on a disk yet, as the camera keeps delivering."""
    over: int = 0
    """Number of instants of a streamed burst that are decided."""
    ended: bool = False
    """Whether the selection of frames has ended: by itself, or as the leader has named those it needs."""
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
        report = report.with_plan(
            instants=tuple(sorted(here)),
            missing=tuple(gap for gap in plan.missing if gap.instant not in here),
            picking=False,
        )
        return cls(report, images=images, spooled=spooled, ended=True, end_is_stored=True)

    def continue_from(self, left: "Upload") -> None:
        """Take over what an earlier run of the node has left of the same streamed burst."""
        self.images, self.disputed = left.images, left.disputed
        self.spooled, self.is_doubted = left.spooled, True

    @property
    def is_picking(self) -> bool:
        """Whether further frames will be selected."""
        return self.streamed and not self.ended

    def take(self, event: UploadInput) -> None:
        """Change the state as TRANSITIONS says."""
        self.state = TRANSITIONS[self.state, event]

    def change_report(self, **changes: Any) -> None:
        """Report these fields of the plan to the leader, before further images."""
        self.report = self.report.with_plan(**changes)
        self.take(_I.CHANGED)

    @property
    def has_ended(self) -> bool:
        """Whether nothing more will be sent."""
        is_sent = not (self.is_picking or self.frames or self.images)
        return self.state is _S.OVER or (self.state is _S.SENDING and is_sent)

    def must_be_reported(self, now_s: float) -> bool:
        """Return whether the leader has to know the report, or to be asked again, at that time."""
        is_due = self.state is _S.WAITING and now_s >= self.due_s
        return is_due or self.state in (_S.UNREPORTED, _S.OUTDATED)

    def put_off(self, due_s: float) -> None:
        """Send nothing of the burst before `due_s`, unless its report changes."""
        self.due_s, self.attempts, self.is_doubted = due_s, self.attempts + 1, True
        self.take(_I.PUT_OFF)

    def stop_selecting(self) -> None:
        """Report that no further frames will be selected."""
        self.ended = True
        self.change_report()

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
                if data is not None and ((self.streamed and not self.is_doubted) or is_intact(image, data)):
                    found[image.record.instant] = data
        return [found.get(image.record.instant) for image in images]

    def extend(self, picked: FramesSelected[CapturedFrame]) -> None:
        """Add frames selected for further instants, unless the leader does not need them.

        Frames of a streamed burst that do not fit into memory are missing.
        """
        if self.ended or self.state is _S.OVER:
            return
        for gap in picked.gaps:
            self._note_missing(gap.instant, gap.reason, dropped=gap.reason == DROPPED)
        if not self.streamed:
            self.frames.extend(picked.frames)
            self.change_report(
                instants=(*self.report.plan.instants, *(frame.instant for frame in picked.frames))
            )
            return
        self.over = max(self.over, picked.over)
        held_bytes = sum(map(len, list(self.in_memory.values()))) + sum(
            waiting.frame.picture.held_bytes for waiting in self.frames
        )
        for frame in filter(lambda of: self._is_needed(of.instant), picked.frames):
            if held_bytes + frame.frame.picture.held_bytes > self.max_bytes:
                self._note_missing(frame.instant, TOO_SLOW if self.spooling else NO_SPOOL)
            else:
                held_bytes += frame.frame.picture.held_bytes
                self.frames.append(frame)
        if picked.ended:
            self.stop_selecting()

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
        self.change_report(camera=replace(camera, widened=(*known, times)))

    def commit(self, requested: Collection[int] | None, end: int | None = None) -> list[Path]:
        """Restrict the upload to the `requested` instants before `end` (None: all); return the dropped files.

        A streamed burst has an `end`, which its operator may have moved while this node was not reached.
        """
        self.take(_I.REQUESTED)
        self.end_instant = end
        self.requested = None if requested is None else frozenset(requested)
        if not self.streamed:
            self.ended |= self.state is _S.SENDING
            self.on_commit()
        self.frames = deque(frame for frame in self.frames if self._is_needed(frame.instant))
        return self._let_go([instant for instant in self.images if not self._is_needed(instant)])

    def _is_needed(self, instant: int) -> bool:
        is_requested = self.requested is None or instant in self.requested
        return is_requested and (self.end_instant is None or instant < self.end_instant)

    def reopen(self) -> None:
        """Reset for a new stream: the leader may be another one, or have changed its mind."""
        self.take(_I.OPENED)
        self.attempts = 0
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
        if not self.images.keys().isdisjoint(stored):
            self.attempts = 0
        return self._let_go(stored)

    def end(self) -> None:
        """Drop the whole burst: its frames, images and report."""
        self.take(_I.ENDED)
        self.frames.clear()
        self._let_go([*self.images])

    def lost_instants(self) -> list[int]:
        """Return the requested instants that were announced, and are neither here nor with the leader."""
        here = {*self.images, *(frame.instant for frame in self.frames)}
        return sorted(filter(self._is_needed, {*self.report.plan.instants} - here - self.confirmed))

    def report_lost(self, instants: Collection[int], reason: str) -> list[Path]:
        """Report announced images that will not come as missing, and drop them; return their files."""
        for instant in instants:
            self._note_missing(instant, cut(reason))
        if not self.streamed or self.ended:
            left = tuple(instant for instant in self.report.plan.instants if instant not in instants)
            self.change_report(instants=left)
        return self._let_go(instants)

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
            self.change_report(missing=(*self.report.plan.missing, gap))
            return
        run = MissingRun(first=instant, count=1, reason=reason, dropped=dropped)
        # A frame can turn out to be missing after later ones, when it is encoded or sent.
        place = bisect_right(self.missing_runs, instant, key=lambda run: run.first)
        last = self.missing_runs[place - 1] if place else run
        if place and instant < last.first + last.count:
            return  # an image of an earlier run of the node, which this one has not seen taken
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
