"""Images from the stream to the disk: received into a file, then saved in batches with one sync."""

import asyncio
import functools
import hashlib
import os
import threading
from collections import Counter
from collections.abc import AsyncIterator, Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AsyncExitStack, asynccontextmanager, closing
from itertools import islice
from pathlib import Path
from typing import ParamSpec, TypeVar

from capture_app.common.errors import DamagedImageError, NetworkError, TryAgainError
from capture_app.common.names import is_name
from capture_app.protocol.messages import FilmPart, ImageReceipt, ImageUpload
from capture_app.session.files.disk import disk_errors
from capture_app.session.files.durable import PART
from capture_app.session.format.manifest import ImageRecord
from capture_app.session.reading.decoding import Size, damage
from capture_app.session.writing.image_store import StoredImage
from capture_app.session.writing.recovery import INCOMING
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.sync.rig.frame_selection import Burst

DISK_THREADS = 8
SYNC_EVERY_S = 0.25
"""Interval at which videos are synced: a node keeps its frames for as long, and more."""
MAX_BATCH = 128
"""Maximum number of images per sync: the first of them waits for the last."""

MAX_WAITING_TRUTH_BYTES = 1 << 20
"""Larger ground truth does not wait for the disk in memory: its camera's next image waits."""

_checking = threading.Lock()
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


class PartialImage:
    """File that one upload is written to; named `camera.instant.sha256.part`, to be found again."""

    def __init__(self, session: Path, upload: ImageUpload) -> None:
        record = upload.record
        self.upload = upload
        self.file = session / INCOMING / f"{record.camera}.{record.instant:06d}.{record.sha256}{PART}"
        self._handle = -1
        self._mutex = threading.Lock()

    def open(self) -> None:
        """Open the file at the upload's offset. Raises TryAgainError where it has fewer bytes than that."""
        with disk_errors(self.file.parent):
            self.file.parent.mkdir(exist_ok=True)
            self._handle = os.open(self.file, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC, 0o666)
            length = os.fstat(self._handle).st_size
            if length >= self.upload.offset:
                os.ftruncate(self._handle, self.upload.offset)
                return
        raise TryAgainError(
            f"this part of the image starts at byte {self.upload.offset}, but only {length} have arrived"
        )

    def add(self, chunk: bytes) -> None:
        """Append received bytes. Raises DiskFullError, NetworkError after `close`."""
        left = memoryview(chunk)
        with disk_errors(self.file.parent), self._mutex:
            if self._handle < 0:
                raise NetworkError("this image is already arriving on another connection")
            while left:
                left = left[os.write(self._handle, left) :]

    def close(self) -> None:
        """Stop writing. Calling it twice is harmless."""
        with self._mutex:
            if self._handle >= 0:
                os.close(self._handle)
                self._handle = -1

    def split_off_truth(self, size: Size) -> bytes:
        """Truncate the file to the image, verify both, and return the ground truth.

        `size` is that of the camera's images, px. Raises TryAgainError where the file does not match the
        upload's header, DamagedImageError for another size or a cut image, and deletes it; DiskError.
        """
        self.close()
        upload, record = self.upload, self.upload.record
        with disk_errors(self.file.parent):
            with self.file.open("r+b") as file:
                length = file.seek(0, os.SEEK_END)
                file.seek(record.bytes)
                truth = file.read(upload.truth_bytes)
                file.truncate(record.bytes)
                file.seek(0)
                sha256 = hashlib.file_digest(file, "sha256").hexdigest()
            arrived = (
                length == record.bytes + upload.truth_bytes
                and sha256 == record.sha256
                and upload.truth_sha256 in (None, hashlib.sha256(truth).hexdigest())
            )
            # One at a time in memory, whatever their size.
            with _checking:
                wrong = damage(self.file.read_bytes(), size) if arrived else ""
            if arrived and not wrong:
                return truth
            self.file.unlink()
        raise DamagedImageError(f"its image is damaged: {wrong}") if arrived else damaged(record)


def check_frames(part: FilmPart, data: memoryview, size: Size) -> list[StoredImage]:
    """Return a part's frames with their bytes, which takes time for large ones.

    `size` is that of the camera's images, px. Raises TryAgainError for frames that were damaged on their way,
    DamagedImageError for those that were damaged before.
    """
    frames, end = [], 0
    wrong: dict[int, str] = {}
    for upload in part.frames:
        begin, end = end, end + upload.record.bytes
        if hashlib.sha256(data[begin:end]).hexdigest() != upload.record.sha256:
            raise damaged(upload.record)
        frames.append(StoredImage(upload.record, data[begin:end], true_ns=upload.true_ns))
        if reason := damage(bytes(data[begin:end]), size):
            wrong[upload.record.instant] = reason
    if wrong:
        raise DamagedImageError(
            f"its image is damaged: {', '.join(sorted({*wrong.values()}))}", instants=tuple(wrong)
        )
    return frames


def partial_receipts(session: Path, camera: str) -> Iterator[ImageReceipt]:
    """Yield receipts of a camera's images whose streams broke off."""
    for file in sorted((session / INCOMING).glob(f"{camera}.*{PART}")):
        name, instant, sha256 = file.name.removesuffix(PART).rsplit(".", 2)
        if name == camera and is_name(camera):
            yield ImageReceipt(instant=int(instant), sha256=sha256, bytes=file.stat().st_size, stored=False)


class Intake:
    """Receiver of one burst's images; images that complete during one sync share the next one."""

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
        # One write at a time: a node that retries after a broken stream meets its own first attempt.
        self._writing = {camera: asyncio.Lock() for camera in cameras}
        self._partial: dict[str, PartialImage] = {}
        """The image that is being received, by camera."""
        self._arrived: dict[str, dict[int, int]] = {camera: {} for camera in self._writing}
        """Number of bytes received of each camera's images, at the furthest attempt."""
        self._video_bytes = Counter[str]()
        """The same for the frames of videos, of which there may be millions."""
        self._saving: dict[tuple[str, int], asyncio.Future[str]] = {}
        """Futures of images that are not safe yet, by camera and number in the session."""
        self._waiting: dict[asyncio.Future[str], tuple[StoredImage, float]] = {}
        """Images in order of arrival, each with its arrival time, by their futures."""
        self._work: asyncio.Task[None] | None = None
        self._unsynced: dict[asyncio.Future[str], tuple[FilmPart, float]] = {}
        """Parts of videos that are not safe yet, each with its arrival time, by their futures."""
        self._syncing: asyncio.Task[None] | None = None

    def find(self, camera: str, instant: int) -> "asyncio.Future[str] | None":
        """Return the future checksum of an image that is saved or being saved; None for any other image."""
        saved = self._writer.image(camera, instant)
        return self._saving.get((camera, instant)) if saved is None else known(saved.sha256)

    def is_saving(self, camera: str) -> bool:
        """Return whether an image of that camera is being saved."""
        return any(of == camera for of, _ in self._saving) or any(
            part.camera == camera for part, _ in self._unsynced.values()
        )

    def arrived_bytes(self, camera: str) -> int:
        """Return the number of bytes received of that camera's images."""
        return sum(self._arrived[camera].values()) + self._video_bytes[camera]

    def mean_bytes(self) -> dict[str, int]:
        """Return the mean size in bytes of each camera's received images with their ground truth."""
        return {camera: sum(sizes.values()) // len(sizes) for camera, sizes in self._arrived.items() if sizes}

    async def receive(
        self, upload: ImageUpload, payload: AsyncIterator[bytes], size: Size
    ) -> "asyncio.Future[str]":
        """Receive an image as it arrives and save it, unless another upload of it was faster: see `add`.

        `size` is that of the camera's images, px. If the stream breaks off with NetworkError, the part
        received so far stays. Raises TryAgainError for an image damaged on its way or once the burst is over,
        DamagedImageError for one that was damaged before, DiskError.
        """
        record, camera, instant = upload.record, upload.camera, upload.record.instant
        partial, arrived = PartialImage(self._writer.folder, upload), self._arrived[camera]
        with closing(partial):
            async with self.interrupted(camera):
                self.check_open()
                self._partial[camera] = partial
                await on_disk(self._disk, partial.open)
            end = upload.offset
            async for chunk in declared(upload, payload):
                await on_disk(self._disk, partial.add, chunk)
                end += len(chunk)
                arrived[instant] = max(arrived.get(instant, 0), end)
        async with self._writing[camera]:
            self.check_open()
            if (others := self.find(camera, instant)) is not None:
                return others
            truth = await on_disk(self._disk, partial.split_off_truth, size)
            saving = self.add(StoredImage(record, partial.file, truth, upload.true_ns))
            if len(truth) > MAX_WAITING_TRUTH_BYTES:
                await asyncio.wait([saving])
            return saving

    async def receive_part(
        self, part: FilmPart, payload: AsyncIterator[bytes], size: Size
    ) -> "asyncio.Future[str]":
        """Append a part of a video; the returned future yields its checksum once it is safe.

        `size` is that of the camera's images, px. Raises TryAgainError for frames damaged on their way, or
        once the burst is over; DamagedImageError for frames that were damaged before, DiskError.
        """
        data = b"".join([chunk async for chunk in declared(part, payload)])
        if len(data) != part.bytes:
            raise damaged(part.frames[0].record)
        async with self._writing[part.camera]:
            self.check_open()

            def append() -> None:
                frames = check_frames(part, memoryview(data), size)
                self._writer.append_frames(part.camera, frames)

            await on_disk(self._disk, append)
            self._video_bytes[part.camera] += len(data)
            loop = asyncio.get_running_loop()
            saved: asyncio.Future[str] = loop.create_future()
            self._unsynced[saved] = part, loop.time()
            saved.add_done_callback(self._unsynced.pop)
        if self._syncing is None:
            self._syncing = asyncio.create_task(self._sync_videos())
        return saved

    async def _sync_videos(self) -> None:
        """Sync what was appended to the videos, at intervals, until nothing more is."""
        try:
            while self._unsynced:
                parts = {saved: part for saved, (part, _) in self._unsynced.items()}
                cameras = list(dict.fromkeys(part.camera for part in parts.values()))
                errors = await asyncio.gather(
                    *(on_disk(self._disk, self._writer.sync_frames, camera) for camera in cameras),
                    return_exceptions=True,
                )
                error_of = dict(zip(cameras, errors, strict=True))
                for saved, part in parts.items():
                    error = error_of[part.camera]
                    # The caller of one that is done no longer waits.
                    if error is not None and not saved.done():
                        saved.set_exception(error)
                    elif not saved.done():
                        saved.set_result(part.sha256)
                await asyncio.sleep(SYNC_EVERY_S)
        finally:
            for saved in tuple(self._unsynced):
                saved.cancel()
            self._syncing = None

    @asynccontextmanager
    async def interrupted(self, camera: str) -> AsyncIterator[None]:
        """Block a camera's writes within the block, and end the image that is being received.

        A stream that the node has abandoned may not have noticed yet.
        """
        async with self._writing[camera]:
            if camera in self._partial:
                self._partial[camera].close()
            yield

    @asynccontextmanager
    async def at_rest(self) -> AsyncIterator[None]:
        """Block all writes within the block, after received images have been saved."""
        async with AsyncExitStack() as stack:
            for writing in self._writing.values():
                await stack.enter_async_context(writing)
            while unsafe := {*self._saving.values(), *self._unsynced}:
                await asyncio.wait(unsafe)
            yield

    def add(self, image: StoredImage) -> "asyncio.Future[str]":
        """Save an image; the returned future yields its checksum once it is safe, or raises its error.

        A second upload of it joins this one from now on.
        """
        loop = asyncio.get_running_loop()
        saved: asyncio.Future[str] = loop.create_future()
        self._waiting[saved], self._saving[image.key] = (image, loop.time()), saved
        saved.add_done_callback(lambda _: self._saving.pop(image.key))
        if self._work is None:
            self._work = asyncio.create_task(self._save_all())
        return saved

    def waiting(self) -> tuple[int, float]:
        """Return the number of images waiting for the disk, and how long the first one has waited, s."""
        now_s = asyncio.get_running_loop().time()
        began_s = [since_s for _, since_s in (*self._waiting.values(), *self._unsynced.values())]
        frames = sum(len(part.frames) for part, _ in self._unsynced.values())
        return len(self._waiting) + frames, now_s - min(began_s, default=now_s)

    async def _save_all(self) -> None:
        try:
            while self._waiting:
                batch = {saved: image for saved, (image, _) in islice(self._waiting.items(), MAX_BATCH)}
                errors = await on_disk(self._disk, self._writer.save, [*batch.values()])
                for (saved, image), error in zip(batch.items(), errors, strict=True):
                    del self._waiting[saved]
                    # The caller of one that is done no longer waits.
                    if error is not None and not saved.done():
                        saved.set_exception(error)
                    elif not saved.done():
                        saved.set_result(image.record.sha256)
        finally:
            for saved in self._waiting:
                saved.cancel()
            self._waiting, self._work = {}, None

    def check_open(self) -> None:
        """Raise TryAgainError once the burst is over."""
        if self._over.is_set():
            raise TryAgainError(f"burst {self._burst.number} is over")


async def declared(upload: ImageUpload | FilmPart, payload: AsyncIterator[bytes]) -> AsyncIterator[bytes]:
    """Yield a payload as it arrives. Raises NetworkError before the first byte beyond its declared size."""
    left = upload.bytes
    async for chunk in payload:
        if (left := left - len(chunk)) < 0:
            raise NetworkError(f"{upload.camera} sent more bytes of an image than it declared")
        yield chunk


def known(sha256: str) -> "asyncio.Future[str]":
    """Return a completed future, for an image that need not be saved."""
    done: asyncio.Future[str] = asyncio.get_running_loop().create_future()
    done.set_result(sha256)
    return done


def damaged(record: ImageRecord) -> TryAgainError:
    """Return the error for an image that does not match its upload's header."""
    return TryAgainError(f"the image of {record.camera} at instant {record.instant} arrived damaged")
