"""Images from the stream to the disk: checked in memory, appended at once, and synced together."""

import asyncio
import functools
import hashlib
from collections import Counter
from collections.abc import AsyncIterator, Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AsyncExitStack, asynccontextmanager
from typing import ParamSpec, TypeVar

from capture_app.common.errors import DamagedImageError, NetworkError, TryAgainError
from capture_app.protocol.messages import ImageBatch
from capture_app.session.reading.decoding import Size, damage
from capture_app.session.writing.image_store import StoredImage
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.sync.rig.frame_selection import Burst

DISK_THREADS = 8
SYNC_EVERY_S = 0.25
"""Interval at which videos are synced: a node keeps its frames for as long, and more."""

P = ParamSpec("P")
T = TypeVar("T")


def disk_threads() -> ThreadPoolExecutor:
    """Return the thread pool that all bursts of a leader share for what blocks on the disk."""
    return ThreadPoolExecutor(DISK_THREADS, "disk")


async def on_disk(
    threads: ThreadPoolExecutor, work: Callable[P, T], *arguments: P.args, **options: P.kwargs
) -> T:
    """Run work that blocks on the disk in one of these threads, and return or raise its result."""
    return await asyncio.get_running_loop().run_in_executor(
        threads, functools.partial(work, *arguments, **options)
    )


def checked_images(batch: ImageBatch, data: memoryview, size: Size) -> list[StoredImage]:
    """Return a batch's images with their bytes, which takes time for large ones.

    `size` is that of the camera's images, px. Raises TryAgainError for images that were damaged on their way,
    DamagedImageError for those that were damaged before.
    """
    images, begin = [], 0
    wrong: dict[int, str] = {}
    for upload in batch.images:
        record, end = upload.record, begin + upload.record.bytes
        image, truth = data[begin:end], data[end : begin + upload.bytes]
        begin += upload.bytes
        expected = (record.sha256, upload.truth_sha256 or _sha256(truth))
        if len(image) != record.bytes or (_sha256(image), _sha256(truth)) != expected:
            raise TryAgainError(f"the image of {record.camera} at instant {record.instant} arrived damaged")
        images.append(StoredImage(record, image, truth, upload.true_ns))
        if reason := damage(bytes(image), size):
            wrong[record.instant] = reason
    if wrong:
        raise DamagedImageError(
            f"its image is damaged: {', '.join(sorted({*wrong.values()}))}", instants=tuple(wrong)
        )
    return images


def _sha256(data: memoryview) -> str:
    return hashlib.sha256(data).hexdigest()


class Intake:
    """Receiver of one burst's images; those that arrive during one sync share the next one."""

    def __init__(
        self,
        writer: SessionWriter,
        disk: ThreadPoolExecutor,
        burst: Burst,
        over: asyncio.Event,
        cameras: Iterable[str],
    ) -> None:
        """Take images of these cameras until the burst is `over`."""
        self._writer, self._disk, self._burst, self._over = writer, disk, burst, over
        self.writing = {camera: asyncio.Lock() for camera in cameras}
        """Held while a camera's images are written: a node that retries after a broken stream meets its own
        first attempt."""
        self._bytes, self._images = Counter[str](), Counter[str]()
        """Number of bytes and images received, by camera."""
        self._arriving: dict[str, dict[int, int]] = {camera: {} for camera in self.writing}
        """Bytes received of incomplete batches, at the furthest attempt of each, by camera and first
        image."""
        self._unsynced: dict[asyncio.Future[str], tuple[ImageBatch, float]] = {}
        """Batches that are not safe yet, each with its arrival time, by their futures."""
        self._syncing: asyncio.Task[None] | None = None

    def is_saving(self, camera: str) -> bool:
        """Return whether an image of that camera is being saved."""
        return any(batch.camera == camera for batch, _ in self._unsynced.values())

    def arrived_bytes(self, camera: str) -> int:
        """Return the number of bytes received of that camera's images."""
        return self._bytes[camera] + sum(self._arriving[camera].values())

    def mean_bytes(self) -> dict[str, int]:
        """Return the mean size in bytes of each camera's received images with their ground truth."""
        return {camera: self._bytes[camera] // number for camera, number in self._images.items()}

    async def receive(
        self, batch: ImageBatch, payload: AsyncIterator[bytes], size: Size
    ) -> "asyncio.Future[str]":
        """Append images to the session; the returned future yields their checksum once they are safe.

        `size` is that of the camera's images, px. Raises TryAgainError for images damaged on their way, for
        those in whose place the session has others, or once the burst is over; DamagedImageError for images
        that were damaged before, DiskError.
        """
        camera, first = batch.camera, batch.images[0].record.instant
        chunks, arriving, size_bytes = [], self._arriving[camera], 0
        async for chunk in payload:
            if (size_bytes := size_bytes + len(chunk)) > batch.bytes:
                raise NetworkError(f"{camera} sent more bytes of an image than it declared")
            chunks.append(chunk)
            arriving[first] = max(arriving.get(first, 0), size_bytes)
        data = memoryview(b"".join(chunks))
        async with self.writing[camera]:
            self.check_open()

            def append() -> None:
                self._check_consistent(batch)
                images = checked_images(batch, data, size)
                self._writer.append(images, in_videos=self._burst.video)

            await on_disk(self._disk, append)
            arriving.pop(first, None)
            self._bytes[camera] += len(data)
            self._images[camera] += len(batch.images)
            loop = asyncio.get_running_loop()
            saved: asyncio.Future[str] = loop.create_future()
            self._unsynced[saved] = batch, loop.time()
        if self._syncing is None:
            self._syncing = asyncio.create_task(self._sync_all())
        return saved

    def _check_consistent(self, batch: ImageBatch) -> None:
        """Raise TryAgainError where the session has another image in the place of one of these."""
        here = {
            image.record.instant: image.sha256
            for other, _ in tuple(self._unsynced.values())
            if other.camera == batch.camera
            for image in other.images
        }
        for image in batch.images:
            instant = image.record.instant
            if (saved := self._writer.image(batch.camera, instant)) is not None:
                here[instant] = saved.sha256
            if here.setdefault(instant, image.sha256) != image.sha256:
                raise TryAgainError(f"{batch.camera} sent another image of instant {instant} before")

    async def _sync_all(self) -> None:
        """Sync what was appended, videos at intervals, until nothing more is."""
        try:
            while self._unsynced:
                batches = {saved: batch for saved, (batch, _) in self._unsynced.items()}
                cameras = list(dict.fromkeys(batch.camera for batch in batches.values()))
                # Each camera has a video of its own, while all images share one journal.
                groups = [[camera] for camera in cameras] if self._burst.video else [cameras]
                errors = await asyncio.gather(
                    *(on_disk(self._disk, self._writer.sync, *group) for group in groups),
                    return_exceptions=True,
                )
                error_of = {
                    camera: error for group, error in zip(groups, errors, strict=True) for camera in group
                }
                for saved, batch in batches.items():
                    del self._unsynced[saved]
                    # The caller of one that is done no longer waits.
                    if saved.done():
                        continue
                    if (error := error_of[batch.camera]) is not None:
                        saved.set_exception(error)
                    elif all(
                        self._writer.has(image.record.camera, image.record.instant) for image in batch.images
                    ):
                        saved.set_result(batch.sha256)
                    else:
                        # An earlier sync, which failed, took them with it before this one began.
                        saved.set_exception(TryAgainError(f"images of {batch.camera} could not be saved"))
                if self._burst.video:
                    await asyncio.sleep(SYNC_EVERY_S)
        finally:
            for saved in tuple(self._unsynced):
                saved.cancel()
            self._syncing = None

    @asynccontextmanager
    async def at_rest(self) -> AsyncIterator[None]:
        """Block all writes within the block, after received images have been saved."""
        async with AsyncExitStack() as stack:
            for writing in self.writing.values():
                await stack.enter_async_context(writing)
            if self._unsynced and self._syncing is not None:
                await asyncio.wait({self._syncing})
            yield

    def waiting(self) -> tuple[int, float]:
        """Return the number of images waiting for the disk, and how long the first one has waited, s."""
        now_s = asyncio.get_running_loop().time()
        began_s = min((since_s for _, since_s in self._unsynced.values()), default=now_s)
        return sum(len(batch.images) for batch, _ in self._unsynced.values()), now_s - began_s

    def check_open(self) -> None:
        """Raise TryAgainError once the burst is over."""
        if self._over.is_set():
            raise TryAgainError(f"burst {self._burst.number} is over")
