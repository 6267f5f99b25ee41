"""The images of one burst as they come in, until each is safely on the disk."""

import asyncio
from collections.abc import AsyncIterator, Callable, Sequence

from msgspec.structs import replace

from capture_app.errors import DiskError, SimulshotError
from capture_app.node.burst.camera_progress import CameraProgress
from capture_app.node.burst.disk_threads import DiskThreads
from capture_app.node.burst.image_commits import ImageCommits, IncomingImage
from capture_app.node.burst.incoming_frames import add_images, ignore_image, known_image, receive_frame
from capture_app.node.burst.instant_choice import InstantChoice
from capture_app.node.transfer.partial_image import PartialImage
from capture_app.node.wire.messages import ImageUpload
from capture_app.session.format.manifest import ImageRecord
from capture_app.session.writing.received_image import ReceivedImage
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.sync.rig.frame_picks import Burst


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
