"""What one camera owes to a burst, and how far it is."""

import asyncio
import functools
from collections.abc import AsyncIterator, Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import ParamSpec, TypeVar

from capture_app.node.transfer.partial_image import PartialImage, partial_receipts
from capture_app.node.wire.messages import ImageReceipt, ImageUpload
from capture_app.node.wire.status import CameraTransfer
from capture_app.session.format.burst_plan import CameraPlan
from capture_app.session.format.manifest import CameraRecord, MissingImage
from capture_app.session.writing.received_image import ReceivedImage
from capture_app.session.writing.session_writer import SessionWriter

PATIENCE_NS = 10_000_000_000
"""A camera that has had no stream open for this long has left its images behind."""
STALL_NS = 180_000_000_000
"""A camera that has a stream open and sends nothing for this long has too."""
DISK_THREADS = 24

P = ParamSpec("P")
T = TypeVar("T")


class DiskThreads:
    """So many that images of many cameras wait together, and share the cost of the disk's syncs."""

    def __init__(self) -> None:
        self._threads = ThreadPoolExecutor(DISK_THREADS, "disk")

    async def call(self, work: Callable[P, T], *arguments: P.args, **options: P.kwargs) -> T:
        """Do work that blocks on the disk, and return or raise what it does."""
        loop = asyncio.get_running_loop()
        return await loop.run_in_executor(self._threads, functools.partial(work, *arguments, **options))


@dataclass(slots=True)
class CameraProgress:
    """One camera's part of a burst; times in ns of the leader's clock."""

    camera: CameraRecord
    heard_ns: int
    streams: int = 0
    report: CameraPlan | None = None
    instants: set[int] = field(default_factory=set)
    """Those whose images are in the session."""
    given_up: str = ""
    silent: bool = False
    """Given up because nothing was heard of it: it may still have its images."""
    partial: PartialImage | None = None
    """The image that is coming in."""
    # One write at a time: a node that sends again after a broken stream meets its own first try.
    writing: asyncio.Lock = field(default_factory=asyncio.Lock)

    def is_complete(self) -> bool:
        """Whether nothing is waited for."""
        return bool(self.given_up) or (self.report is not None and self.instants >= set(self.report.instants))

    def transfer(self, instants: int) -> CameraTransfer:
        """How much of so many instants it has brought."""
        return CameraTransfer(
            camera=self.camera.name, received=len(self.instants), expected=instants, problem=self.given_up
        )

    def why_silent(self, lost: Mapping[str, str], now_ns: int) -> str:
        """Why not to wait for it any longer, empty where there is no reason; `lost` are reasons by name."""
        silent_ns, name = now_ns - self.heard_ns, self.camera.name
        if silent_ns >= PATIENCE_NS and (not self.streams or name in lost):
            return lost.get(name, "it sent nothing")
        return f"it sent nothing for {STALL_NS // 10**9} s" if silent_ns >= STALL_NS else ""

    def note_heard(self, now_ns: int) -> None:
        """The camera has been heard of."""
        self.heard_ns = max(self.heard_ns, now_ns)

    def interrupt(self) -> None:
        """End the image that is coming in: a stream that the node has left may not have noticed yet."""
        if self.partial is not None:
            self.partial.close()

    def receipts(self, writer: SessionWriter) -> tuple[ImageReceipt, ...]:
        """What is here of its images, whole or in part. Blocks on the disk."""
        name = self.camera.name
        images = [writer.image(name, instant) for instant in sorted(self.instants)]
        stored = (
            ImageReceipt(instant=image.instant, sha256=image.sha256, bytes=image.bytes, stored=True)
            for image in images
            if image is not None
        )
        return (*stored, *partial_receipts(writer.folder, name))

    def missing_images(
        self, instants: int, lost: Mapping[tuple[str, int], MissingImage]
    ) -> list[MissingImage]:
        """What has not come of that many instants, and why; `lost` are reasons from before."""
        name = self.camera.name
        told = {gap.instant: gap for (camera, _), gap in lost.items() if camera == name}
        told |= {gap.instant: gap for gap in self.report.missing} if self.report else {}
        return [
            told.get(instant)
            or MissingImage(camera=name, instant=instant, reason=self.given_up or "it never came")
            for instant in range(instants)
            if instant not in self.instants
        ]

    async def receive_image(
        self,
        upload: ImageUpload,
        payload: AsyncIterator[bytes],
        writer: SessionWriter,
        disk: DiskThreads,
        check_open: Callable[[], None],
    ) -> None:
        """Write an image as it comes in; `check_open` raises where the burst takes no more.

        What came of it stays where the stream breaks off. Raises what `PartialImage` and the writer raise.
        """
        partial = PartialImage(writer.folder, upload)
        async with self.writing:
            check_open()
            self.interrupt()
            self.partial = partial
            await disk.call(partial.open)
        try:
            async for chunk in payload:
                await disk.call(partial.add, chunk)
        finally:
            partial.close()
        async with self.writing:
            check_open()
            if upload.record.instant not in self.instants:
                await disk.call(_add_to_session, writer, partial)
                self.instants.add(upload.record.instant)


def _add_to_session(writer: SessionWriter, partial: PartialImage) -> None:
    truth, upload = partial.split_off_truth(), partial.upload
    for error in writer.add_received([ReceivedImage(upload.record, partial.file, truth, upload.true_ns)]):
        if error is not None:
            raise error
