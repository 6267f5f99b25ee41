"""What one camera owes to a burst: what it has told, the image that comes in, how long it is waited for."""

import asyncio
import hashlib
import os
import threading
from collections.abc import AsyncIterator, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from msgspec.structs import replace

from capture_app.errors import NetworkError, TryAgainError
from capture_app.names import is_name
from capture_app.node.burst.intake import DiskThreads
from capture_app.node.burst.plans import InstantChoice
from capture_app.node.wire.messages import ImageReceipt, ImageUpload
from capture_app.node.wire.status import CameraTransfer
from capture_app.session.files.disk import disk_error
from capture_app.session.files.durable import PART
from capture_app.session.format.burst_plan import CameraPlan
from capture_app.session.format.manifest import MissingImage
from capture_app.session.writing.instant_set import InstantSet
from capture_app.session.writing.recovery import INCOMING
from capture_app.session.writing.session_writer import SessionWriter

_BLOCK = 1 << 20


class PartialImage:
    """The file that one upload is written to; `camera.instant.sha256.part`, so that it can be found again."""

    def __init__(self, session: Path, upload: ImageUpload) -> None:
        record = upload.record
        self.upload = upload
        self.file = session / INCOMING / f"{record.camera}.{record.instant:06d}.{record.sha256}{PART}"
        self._handle = -1
        self._mutex = threading.Lock()

    def open(self) -> None:
        """Go on at the upload's offset. Raises TryAgainError where less than that has come before."""
        try:
            self.file.parent.mkdir(exist_ok=True)
            self._handle = os.open(self.file, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o666)
            length = os.fstat(self._handle).st_size
            if length >= self.upload.offset:
                os.ftruncate(self._handle, self.upload.offset)
                os.lseek(self._handle, self.upload.offset, os.SEEK_SET)
                return
        except OSError as error:
            self.close()
            raise disk_error(error, self.file.parent) from error
        self.close()
        raise TryAgainError(
            f"this image goes on at byte {self.upload.offset}, but only {length} have arrived"
        )

    def add(self, chunk: bytes) -> None:
        """Write what has come. Raises DiskFullError, NetworkError after `close`."""
        left = memoryview(chunk)
        try:
            with self._mutex:
                if self._handle < 0:
                    raise NetworkError("this image is already arriving on another connection")
                while left:
                    left = left[os.write(self._handle, left) :]
        except OSError as error:
            self.close()
            raise disk_error(error, self.file.parent) from error

    def close(self) -> None:
        """Write no more. Calling it twice is harmless."""
        with self._mutex:
            if self._handle >= 0:
                os.close(self._handle)
                self._handle = -1

    def split_off_truth(self) -> bytes:
        """Check what has come, leave the image alone in the file, and return the ground truth.

        Raises TryAgainError, and deletes the file, where it is not what the upload tells; DiskError.
        """
        self.close()
        upload, record = self.upload, self.upload.record
        sha256 = hashlib.sha256()
        try:
            with self.file.open("rb") as file:
                length = os.fstat(file.fileno()).st_size
                left = record.bytes
                while left and (block := file.read(min(left, _BLOCK))):
                    sha256.update(block)
                    left -= len(block)
                truth = file.read(upload.truth_bytes)
            whole = length == record.bytes + upload.truth_bytes and sha256.hexdigest() == record.sha256
            if whole and upload.truth_sha256 is not None:
                whole = hashlib.sha256(truth).hexdigest() == upload.truth_sha256
            if whole:
                os.truncate(self.file, record.bytes)
                return truth
            self.file.unlink()
        except OSError as error:
            raise disk_error(error, self.file.parent) from error
        raise TryAgainError(f"the image of {record.camera} at instant {record.instant} arrived damaged")


def partial_receipts(session: Path, camera: str) -> Iterator[ImageReceipt]:
    """Yield what has come of a camera's images whose streams broke off."""
    for file in sorted((session / INCOMING).glob(f"{camera}.*{PART}")):
        name, instant, sha256 = file.name.removesuffix(PART).rsplit(".", 2)
        if name == camera and is_name(camera):
            yield ImageReceipt(instant=int(instant), sha256=sha256, bytes=file.stat().st_size, stored=False)


PATIENCE_NS = 10_000_000_000
"""A camera that has had no stream open for this long has left its images behind."""
SHORT_TIMEOUT_NS = 2_000_000_000
"""How long a camera is waited for that left the burst before without a word."""
STALL_NS = 180_000_000_000
"""A camera that has a stream open and sends nothing for this long has too."""
AFTER_LAST_INSTANT_NS = 2_000_000_000
"""A camera is waited for from so long after its last frame on."""
ADVANCE_BYTES = 1 << 18
"""How much of an image counts as something: a slow link brings less than a whole one in all that time."""


@dataclass(slots=True)
class CameraShare:
    """What one camera owes to a burst, and how far it is; times in ns of the leader's clock."""

    plan: CameraPlan
    """What it has told, with the instants' numbers as they were ordered."""
    heard_ns: int
    short_timeout: bool = False
    """It brought nothing of the burst before, without a word: it is waited for less."""
    instants: InstantSet = field(default_factory=InstantSet)
    """Whose images are in the session, with their numbers there."""
    streams: int = 0
    advanced_ns: int = 0
    """When it last brought something, or had to wait for others."""
    arrived: dict[int, int] = field(default_factory=dict)
    """How many bytes have come of each image, where it came furthest."""
    counted_bytes: int = 0
    """How many of them are counted as an advance."""
    given_up: str = ""
    silent: bool = False
    """Given up because nothing was heard of it: it may still have its images."""
    partial: PartialImage | None = None
    """The image that is coming in."""
    saving: "dict[int, asyncio.Future[str]]" = field(default_factory=dict)
    """By their numbers in the session, the images that have come and are not safely on the disk yet."""
    # One write at a time: a node that sends again after a broken stream meets its own first try.
    writing: asyncio.Lock = field(default_factory=asyncio.Lock)

    def __post_init__(self) -> None:
        """Count as advanced from when it is waited for."""
        self.advanced_ns = max(self.advanced_ns, self.heard_ns)

    @property
    def name(self) -> str:
        """The camera's."""
        return self.plan.camera.name

    @property
    def told(self) -> CameraPlan | None:
        """The plan, once the camera has told it."""
        return self.plan if self.plan.reported else None

    def is_complete(self, choice: InstantChoice) -> bool:
        """Whether nothing is waited for."""
        plan = self.plan
        if self.given_up:
            return True
        if not plan.reported or not choice.is_committed or plan.picking:
            return False
        if plan.picked is not None:
            decided = min(plan.picked, len(choice.chosen or ()))
            gone = sum(max(0, min(run.first + run.count, decided) - run.first) for run in plan.missing_runs)
            return len(self.instants) >= decided - gone
        return self.instants >= choice.numbers(plan.instants)

    def transfer(self, instants: int) -> CameraTransfer:
        """How much of so many instants it has brought."""
        return CameraTransfer(
            camera=self.name, received=len(self.instants), expected=instants, problem=self.given_up
        )

    def why_silent(self, lost: Mapping[str, str], now_ns: int) -> str:
        """Why not to wait for it any longer, empty where there is no reason; `lost` are reasons by name."""
        if self.saving:
            return ""
        silent_ns = now_ns - self.heard_ns
        gone_ns, stalled_ns = (
            (SHORT_TIMEOUT_NS, PATIENCE_NS) if self.short_timeout else (PATIENCE_NS, STALL_NS)
        )
        if silent_ns >= gone_ns and (not self.streams or self.name in lost):
            return lost.get(self.name, "it sent nothing")
        if self.streams and self.name not in lost and self.plan.picking:
            # The next instant may be hours away.
            return ""
        # Words without images do not count, nor images that trickle: they could go on for ever.
        stalled = now_ns - self.advanced_ns >= stalled_ns
        return f"it sent nothing for {stalled_ns // 10**9} s" if stalled else ""

    def note_heard(self, now_ns: int, *, advanced: bool = False) -> None:
        """The camera has been heard of; `advanced` where it brought something, or waits for others."""
        self.heard_ns = max(self.heard_ns, now_ns)
        if advanced:
            self.advanced_ns = max(self.advanced_ns, now_ns)

    def note_arrivals(self, now_ns: int) -> None:
        """Count what has come of images since the last time, where it is enough."""
        arrived = sum(self.arrived.values())
        if arrived - self.counted_bytes >= ADVANCE_BYTES:
            self.counted_bytes = arrived
            self.note_heard(now_ns, advanced=True)

    def note_report(self, told: CameraPlan, *, is_of_earlier_run: bool) -> None:
        """Take what the camera tells for its plan, and wait for it.

        What an earlier run of the leader knew the camera to be stays: only what is to come is told anew.
        """
        if is_of_earlier_run and self.plan.reported:
            before = self.plan
            told = replace(
                told, camera=before.camera, calibration=before.calibration, true_clock=before.true_clock
            )
        self.plan = replace(told, reported=True)
        self.given_up, self.silent = "", False

    def interrupt(self) -> None:
        """End the image that is coming in: a stream that the node has left may not have noticed yet."""
        if self.partial is not None:
            self.partial.close()

    async def receive(self, partial: PartialImage, payload: AsyncIterator[bytes], disk: DiskThreads) -> None:
        """Write an image into its file as it comes in.

        What came of it stays where the stream breaks off. Raises what `PartialImage` raises.
        """
        instant, end = partial.upload.record.instant, partial.upload.offset
        try:
            async for chunk in payload:
                await disk.call(partial.add, chunk)
                end += len(chunk)
                self.arrived[instant] = max(self.arrived.get(instant, 0), end)
        finally:
            partial.close()

    def receipts(self, writer: SessionWriter, choice: InstantChoice) -> tuple[ImageReceipt, ...]:
        """What is here of its images, whole or in part, numbered as ordered. Blocks on the disk.

        Of images that are sent as they come only those count that the camera says it still has.
        """
        chosen, plan = choice.chosen or (), self.plan
        sent_as_they_come = plan.picking or plan.picked is not None
        asked = self.instants & {*plan.instants} if sent_as_they_come else self.instants
        images = [writer.image(self.name, instant) for instant in sorted(asked)]
        stored = (
            ImageReceipt(instant=image.instant, sha256=image.sha256, bytes=image.bytes, stored=True)
            for image in images
            if image is not None
        )
        return tuple(
            replace(receipt, instant=chosen[receipt.instant])
            for receipt in (*stored, *partial_receipts(writer.folder, self.name))
            if receipt.instant < len(chosen)
        )

    def missing_images(
        self, choice: InstantChoice, lost: Mapping[tuple[str, int], MissingImage]
    ) -> list[MissingImage]:
        """What has not come of the session's instants, and why; `lost` are reasons from before."""
        name, chosen = self.name, choice.chosen or ()
        told = {gap.instant: gap for (camera, _), gap in lost.items() if camera == name}
        for run in self.plan.missing_runs:
            for instant in range(run.first, min(run.first + run.count, len(chosen))):
                told[instant] = MissingImage(
                    camera=name, instant=instant, reason=run.reason, dropped=run.dropped
                )
        for gap in self.plan.missing:
            if gap.instant in chosen:
                number = chosen.index(gap.instant)
                told[number] = replace(gap, instant=number)
        return [
            told.get(number)
            or MissingImage(camera=name, instant=number, reason=self.given_up or "it never came")
            for number in range(len(chosen))
            if number not in self.instants
        ]
