"""What one camera owes: its report, its partial image, its patience.

An image on its way into a session: as much of it as has come survives a stream that breaks off.

The threads of a leader that wait for its disk.

What one camera owes to a burst, and how far it is.
"""

import asyncio
import functools
import hashlib
import os
import threading
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import ParamSpec, TypeVar

from msgspec.structs import replace

from capture_app.errors import NetworkError, TryAgainError
from capture_app.names import is_name
from capture_app.node.burst.instant_choice import InstantChoice
from capture_app.node.wire.messages import ImageReceipt, ImageUpload
from capture_app.node.wire.status import CameraTransfer
from capture_app.session.files.disk import disk_error
from capture_app.session.files.durable import PART
from capture_app.session.format.burst_plan import CameraPlan
from capture_app.session.format.manifest import CameraRecord, MissingImage
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
        try:
            return self._split_off_truth()
        except OSError as error:
            raise disk_error(error, self.file.parent) from error

    def _split_off_truth(self) -> bytes:
        upload, record = self.upload, self.upload.record
        sha256 = hashlib.sha256()
        truth = b""
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
        if not whole:
            self.file.unlink()
            raise TryAgainError(f"the image of {record.camera} at instant {record.instant} arrived damaged")
        os.truncate(self.file, record.bytes)
        return truth


def partial_receipts(session: Path, camera: str) -> Iterator[ImageReceipt]:
    """Yield what has come of a camera's images whose streams broke off."""
    for file in sorted((session / INCOMING).glob(f"{camera}.*{PART}")):
        name, instant, sha256 = file.name.removesuffix(PART).rsplit(".", 2)
        if name == camera and is_name(camera):
            yield ImageReceipt(instant=int(instant), sha256=sha256, bytes=file.stat().st_size, stored=False)


DISK_THREADS = 8

P = ParamSpec("P")
T = TypeVar("T")


class DiskThreads:
    """One pool for all bursts of a leader; its threads end with `close`."""

    def __init__(self) -> None:
        self._threads = ThreadPoolExecutor(DISK_THREADS, "disk")

    async def call(self, work: Callable[P, T], *arguments: P.args, **options: P.kwargs) -> T:
        """Do work that blocks on the disk, and return or raise what it does."""
        loop = asyncio.get_running_loop()
        return await loop.run_in_executor(self._threads, functools.partial(work, *arguments, **options))

    def close(self) -> None:
        """Take on no more work, and end when what was begun is done."""
        self._threads.shutdown(wait=False)


PATIENCE_NS = 10_000_000_000
"""A camera that has had no stream open for this long has left its images behind."""
HASTE_NS = 2_000_000_000
"""The same of a camera that left the burst before without a word."""
STALL_NS = 180_000_000_000
"""A camera that has a stream open and sends nothing for this long has too."""
ADVANCE_BYTES = 1 << 18
"""So much of an image is something: a slow link brings less than a whole one in all that time."""


@dataclass(slots=True)
class CameraProgress:
    """One camera's part of a burst; times in ns of the leader's clock."""

    camera: CameraRecord
    heard_ns: int
    streams: int = 0
    report: CameraPlan | None = None
    """What it has told, with the instants' numbers as they were ordered."""
    instants: InstantSet = field(default_factory=InstantSet)
    """Those whose images are in the session, with their numbers there."""
    was_silent: bool = False
    """It brought nothing of the burst before, without a word: it is waited for less."""
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

    def is_complete(self, choice: InstantChoice) -> bool:
        """Whether nothing is waited for."""
        if self.given_up:
            return True
        if self.report is None or not choice.is_settled or self.report.picking:
            return False
        if self.report.picked is not None:
            decided = min(self.report.picked, len(choice.chosen or ()))
            gone = sum(
                max(0, min(run.first + run.count, decided) - run.first) for run in self.report.missing_runs
            )
            return len(self.instants) >= decided - gone
        return self.instants >= choice.numbers(self.report.instants)

    def transfer(self, instants: int) -> CameraTransfer:
        """How much of so many instants it has brought."""
        return CameraTransfer(
            camera=self.camera.name, received=len(self.instants), expected=instants, problem=self.given_up
        )

    def why_silent(self, lost: Mapping[str, str], now_ns: int) -> str:
        """Why not to wait for it any longer, empty where there is no reason; `lost` are reasons by name."""
        if self.saving:
            return ""
        silent_ns, name = now_ns - self.heard_ns, self.camera.name
        gone_ns, stalled_ns = (HASTE_NS, PATIENCE_NS) if self.was_silent else (PATIENCE_NS, STALL_NS)
        if silent_ns >= gone_ns and (not self.streams or name in lost):
            return lost.get(name, "it sent nothing")
        if self.streams and name not in lost and self.report is not None and self.report.picking:
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

    def interrupt(self) -> None:
        """End the image that is coming in: a stream that the node has left may not have noticed yet."""
        if self.partial is not None:
            self.partial.close()

    def receipts(self, writer: SessionWriter, choice: InstantChoice) -> tuple[ImageReceipt, ...]:
        """What is here of its images, whole or in part, numbered as ordered. Blocks on the disk.

        Of images that are sent as they come only those count that the camera says it still has.
        """
        name, chosen, report = self.camera.name, choice.chosen or (), self.report
        sent_as_they_come = report is not None and (report.picking or report.picked is not None)
        asked = self.instants & {*report.instants} if report and sent_as_they_come else self.instants
        images = [writer.image(name, instant) for instant in sorted(asked)]
        stored = (
            ImageReceipt(instant=image.instant, sha256=image.sha256, bytes=image.bytes, stored=True)
            for image in images
            if image is not None
        )
        return tuple(
            replace(receipt, instant=chosen[receipt.instant])
            for receipt in (*stored, *partial_receipts(writer.folder, name))
            if receipt.instant < len(chosen)
        )

    def missing_images(
        self, choice: InstantChoice, lost: Mapping[tuple[str, int], MissingImage]
    ) -> list[MissingImage]:
        """What has not come of the session's instants, and why; `lost` are reasons from before."""
        name, chosen = self.camera.name, choice.chosen or ()
        told = {gap.instant: gap for (camera, _), gap in lost.items() if camera == name}
        for run in self.report.missing_runs if self.report else ():
            for instant in range(run.first, min(run.first + run.count, len(chosen))):
                told[instant] = MissingImage(
                    camera=name, instant=instant, reason=run.reason, dropped=run.dropped
                )
        for gap in self.report.missing if self.report else ():
            if gap.instant in chosen:
                number = chosen.index(gap.instant)
                told[number] = replace(gap, instant=number)
        return [
            told.get(number)
            or MissingImage(camera=name, instant=number, reason=self.given_up or "it never came")
            for number in range(len(chosen))
            if number not in self.instants
        ]

    async def receive_image(
        self,
        partial: PartialImage,
        payload: AsyncIterator[bytes],
        disk: DiskThreads,
        check_open: Callable[[], None],
    ) -> None:
        """Write an image into its file as it comes in; `check_open` raises where the burst takes no more.

        What came of it stays where the stream breaks off. Raises what `PartialImage` raises.
        """
        async with self.writing:
            check_open()
            self.interrupt()
            self.partial = partial
            await disk.call(partial.open)
        instant, end = partial.upload.record.instant, partial.upload.offset
        try:
            async for chunk in payload:
                await disk.call(partial.add, chunk)
                end += len(chunk)
                self.arrived[instant] = max(self.arrived.get(instant, 0), end)
        finally:
            partial.close()
