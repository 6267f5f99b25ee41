"""Images from the stream to the disk, those of one sync together.

Images that have come, on their way to the disk: all that arrive during one sync share the next.

Frames of a video as they come in: whole in memory, then added to their camera's video together.

The images of one burst as they come in, until each is safely on the disk.
"""

import asyncio
import dataclasses
import hashlib
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass

from msgspec.structs import replace

from capture_app.errors import DiskError, SimulshotError, TryAgainError
from capture_app.node.burst.camera_share import CameraProgress, DiskThreads, PartialImage
from capture_app.node.burst.instant_choice import InstantChoice
from capture_app.node.wire.messages import ImageUpload
from capture_app.session.format.manifest import ImageRecord
from capture_app.session.writing.image_store import ReceivedImage
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.session.writing.video_store import NewFrame
from capture_app.sync.rig.frame_picks import Burst

IncomingImage = ReceivedImage | NewFrame
MAX_BATCH = 128
"""So many images are synced together at most: the first of them waits for the last."""


@dataclass(frozen=True, slots=True)
class _Waiting:
    image: IncomingImage
    saved: "asyncio.Future[None]"
    since_s: float


class ImageCommits:
    """Those of one session; one batch after the other is saved, however many streams bring images."""

    def __init__(
        self,
        save: Callable[[Sequence[IncomingImage]], Awaitable[list[SimulshotError | None]]],
        on_saved: Callable[[ImageRecord], None],
    ) -> None:
        """`save` returns when images are safely on the disk, `on_saved` is told first."""
        self._save = save
        self._on_saved = on_saved
        self._queue: list[_Waiting] = []
        self._batch: list[_Waiting] = []
        self._work: asyncio.Task[None] | None = None

    def add(self, image: IncomingImage) -> "asyncio.Future[None]":
        """Save an image; what is returned is done, or has an error, when that has been done."""
        loop = asyncio.get_running_loop()
        waiting = _Waiting(image, loop.create_future(), loop.time())
        self._queue.append(waiting)
        if self._work is None:
            self._work = asyncio.create_task(self._save_all())
        return waiting.saved

    def waiting(self) -> tuple[int, float]:
        """How many images wait for the disk, and since how many seconds the first of them does."""
        all_waiting = [*self._batch, *self._queue]
        if not all_waiting:
            return 0, 0.0
        return len(all_waiting), asyncio.get_running_loop().time() - all_waiting[0].since_s

    async def wait_until_idle(self) -> None:
        """Wait until no image is being saved."""
        while self._work is not None:
            await asyncio.wait({self._work})

    async def _save_all(self) -> None:
        try:
            while self._queue:
                self._batch, self._queue = self._queue[:MAX_BATCH], self._queue[MAX_BATCH:]
                try:
                    errors = await self._save([waiting.image for waiting in self._batch])
                except SimulshotError as error:
                    errors = [error] * len(self._batch)
                for waiting, failure in zip(self._batch, errors, strict=True):
                    if failure is None:
                        self._on_saved(waiting.image.record)
                    if waiting.saved.done():
                        continue  # nobody waits for it any more
                    if failure is None:
                        waiting.saved.set_result(None)
                    else:
                        waiting.saved.set_exception(failure)
                self._batch = []
        finally:
            for waiting in (*self._batch, *self._queue):
                waiting.saved.cancel()
            self._batch, self._queue, self._work = [], [], None


async def receive_frame(upload: ImageUpload, payload: AsyncIterator[bytes]) -> NewFrame:
    """Take a frame in. Raises TryAgainError where it is not what the upload tells, NetworkError."""
    data, record = b"".join([chunk async for chunk in payload]), upload.record
    whole = not upload.offset and not upload.truth_bytes and len(data) == record.bytes
    if not whole or hashlib.sha256(data).hexdigest() != record.sha256:
        raise TryAgainError(f"the frame of {record.camera} at instant {record.instant} arrived damaged")
    return NewFrame(record, data, upload.true_ns)


def add_images(writer: SessionWriter, images: Sequence[IncomingImage]) -> list[SimulshotError | None]:
    """Add images to a session, and frames to its videos; return what went wrong with each.

    Blocks on the disk, and for each camera's video once.
    """
    errors: dict[int, SimulshotError | None] = {}
    files = [(place, image) for place, image in enumerate(images) if isinstance(image, ReceivedImage)]
    if files:
        saved = writer.add_received([image for _, image in files])
        errors |= {place: error for (place, _), error in zip(files, saved, strict=True)}
    frames: dict[str, list[tuple[int, NewFrame]]] = {}
    for place, image in enumerate(images):
        if isinstance(image, NewFrame):
            frames.setdefault(image.record.camera, []).append((place, image))
    for new in frames.values():
        failure: SimulshotError | None = None
        try:
            writer.add_frames([frame for _, frame in new])
        except SimulshotError as error:
            failure = error
        errors |= dict.fromkeys((place for place, _ in new), failure)
    return [errors[place] for place in range(len(images))]


def shortened(burst: Burst, cameras: Mapping[str, CameraProgress]) -> Burst:
    """A recording as long as any of its cameras has recorded."""
    told = [of.report.picked or 0 for of in cameras.values() if of.report is not None]
    frames = max([1, *told, *(camera.instants.end for camera in cameras.values())])
    return dataclasses.replace(burst, instants_ns=burst.instants_ns[:frames])


def known_image(sha256: str) -> "asyncio.Future[str]":
    """The answer for an image that need not be saved."""
    done: asyncio.Future[str] = asyncio.get_running_loop().create_future()
    done.set_result(sha256)
    return done


async def ignore_image(upload: ImageUpload, payload: AsyncIterator[bytes]) -> "asyncio.Future[str]":
    """Answer for an image of an instant that the burst does without."""
    async for _ in payload:
        pass
    return known_image(upload.record.sha256)


class ImageIntake:
    """Takes images in, into files of their own or videos, and saves those that come together at once."""

    def __init__(
        self,
        writer: SessionWriter,
        disk: DiskThreads,
        choice: InstantChoice,
        find_camera: Callable[[str], CameraProgress],
        *,
        check_open: Callable[[], None],
        on_saved: Callable[[], None],
        on_failure: Callable[[DiskError], None],
    ) -> None:
        """`find_camera` raises BadInputError for one that is not in the burst.

        `check_open` raises where the burst takes no more; `on_saved` is called after each image that is safe,
        `on_failure` where the disk takes none.
        """
        self.commits = ImageCommits(self._save, self._note_saved)
        """Those that wait for the disk."""
        self._writer = writer
        self._disk = disk
        self._choice = choice
        self._find_camera = find_camera
        self._check_open = check_open
        self._on_saved = on_saved
        self._on_failure = on_failure

    async def take(
        self, burst: Burst, upload: ImageUpload, payload: AsyncIterator[bytes], now_ns: int
    ) -> "asyncio.Future[str]":
        """Take an image in as it comes; the future that is returned has its checksum once it is on disk.

        What came of it stays where the stream breaks off, with NetworkError. Raises BadInputError,
        TryAgainError for a damaged one, DiskFullError, as does the future.
        """
        self._check_open()
        if burst.streamed and upload.record.instant >= burst.frames:
            # The node heard late that the burst ends earlier.
            return await ignore_image(upload, payload)
        record, camera = self._choice.renumbered(upload.record), self._find_camera(upload.record.camera)
        known = self._writer.image(record.camera, record.instant)
        if known is not None:
            return known_image(known.sha256)
        if record.instant in camera.saving:
            return camera.saving[record.instant]
        if burst.video:
            frame = await receive_frame(replace(upload, record=record), payload)
            self._check_open()
            saving: asyncio.Future[str] = self._commit(camera, frame)
        else:
            saving = await self._take_file(camera, replace(upload, record=record), payload)
        camera.note_heard(now_ns, advanced=True)
        return saving

    async def _take_file(
        self, camera: CameraProgress, upload: ImageUpload, payload: AsyncIterator[bytes]
    ) -> "asyncio.Future[str]":
        partial = PartialImage(self._writer.folder, upload)
        try:
            await camera.receive_image(partial, payload, self._disk, self._check_open)
            async with camera.writing:
                self._check_open()
                if upload.record.instant in camera.saving:
                    return camera.saving[upload.record.instant]
                truth = await self._disk.call(partial.split_off_truth)
                return self._commit(camera, ReceivedImage(upload.record, partial.file, truth, upload.true_ns))
        except DiskError as error:
            self._on_failure(error)
            raise

    def _commit(self, camera: CameraProgress, image: IncomingImage) -> "asyncio.Task[str]":
        saved = self.commits.add(image)
        task = asyncio.create_task(self._wait_until_saved(camera, image.record, saved))
        camera.saving[image.record.instant] = task
        return task

    async def _save(self, images: Sequence[IncomingImage]) -> list[SimulshotError | None]:
        return await self._disk.call(add_images, self._writer, images)

    def _note_saved(self, record: ImageRecord) -> None:
        self._find_camera(record.camera).instants.add(record.instant)

    async def _wait_until_saved(
        self, camera: CameraProgress, record: ImageRecord, saved: "asyncio.Future[None]"
    ) -> str:
        try:
            await saved
        except DiskError as error:
            self._on_failure(error)
            raise
        finally:
            camera.saving.pop(record.instant, None)
        # The node hears of its image before the session is finished, which takes the disk some time.
        self._on_saved()
        return record.sha256
