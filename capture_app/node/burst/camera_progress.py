"""What one camera owes to a burst, and how far it is."""

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping
from dataclasses import dataclass, field

from msgspec.structs import replace

from capture_app.node.burst.disk_threads import DiskThreads
from capture_app.node.burst.instant_choice import InstantChoice
from capture_app.node.transfer.partial_image import PartialImage, partial_receipts
from capture_app.node.wire.messages import ImageReceipt
from capture_app.node.wire.status import CameraTransfer
from capture_app.session.format.burst_plan import CameraPlan
from capture_app.session.format.manifest import CameraRecord, MissingImage
from capture_app.session.writing.instant_set import InstantSet
from capture_app.session.writing.session_writer import SessionWriter

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
