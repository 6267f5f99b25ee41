"""A burst on the leader's side: reports and images come in, a session comes out, whatever is missing."""

import asyncio
import threading
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path

from capture_app.camera_facts import CameraFacts
from capture_app.errors import BadInputError, DiskFullError, SimulshotError, TryAgainError
from capture_app.node.burst import plans
from capture_app.node.burst.camera_progress import CameraProgress, DiskThreads
from capture_app.node.wire.messages import CameraReport, ImageReceipt, ImageUpload
from capture_app.node.wire.status import BurstStatus
from capture_app.session.format.burst_plan import CameraPlan
from capture_app.session.format.manifest import CameraRecord
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.sync.rig.frame_picks import Burst

AFTER_LAST_INSTANT_NS = 2_000_000_000


class BurstSession:
    """Collects one burst into a session; finished when every camera has delivered or is given up."""

    def __init__(
        self,
        burst: Burst,
        cameras: Mapping[str, CameraFacts],
        writer: SessionWriter,
        *,
        interrupted: plans.InterruptedBurst | None = None,
    ) -> None:
        """Begin with these cameras, or go on where an earlier run left off."""
        self.burst = burst
        self.finished = asyncio.Event()
        self.session: Path | None = None
        self.message = ""
        self._writer = writer
        self._planning = threading.Lock()
        self._disk = DiskThreads()
        self._interrupted = interrupted
        begin_ns = burst.instants_ns[-1] + AFTER_LAST_INSTANT_NS
        self._cameras = {
            name: CameraProgress(CameraRecord(name=name, facts=facts), begin_ns)
            for name, facts in cameras.items()
            if name in burst.clients
        }
        if interrupted is not None:
            self._cameras = interrupted.cameras

    @classmethod
    def resume(cls, folder: Path, heard_ns: int) -> "BurstSession":
        """Go on with a burst that was interrupted or lacks images; its cameras count as heard at `heard_ns`.

        Blocks on the disk. Raises BadInputError where the session has no plan, TryAgainError where another
        process writes it.
        """
        before = plans.InterruptedBurst.read(folder, heard_ns)
        return cls(before.burst, {}, before.writer, interrupted=before)

    async def write_plan(self, leader: int, note: str = "") -> None:
        """Put on disk what this is to become; `leader` is the run of the leader that nodes know it by.

        Raises DiskFullError where there is no room for it.
        """
        cameras = [camera.camera for camera in self._cameras.values()]
        plan = plans.first_plan(
            self._writer, leader, self.burst.number, plans.burst_record(self.burst), cameras, note
        )
        async with self._no_image_written():
            await self._disk.call(self._writer.set_plan, plan)

    @property
    def status(self) -> BurstStatus:
        """How far it is; a burst of an earlier run has no number in this one."""
        instants = len(self.burst.instants_ns)
        received = sum(len(camera.instants) for camera in self._cameras.values())
        expected = len(self._cameras) * instants
        done, message, resumed = self.finished.is_set(), self.message, self._interrupted is not None
        if resumed:
            message = f"{self._writer.name} of an earlier run: {received} of {expected} images" + (
                f"; {message}" if message else "" if done else ", waiting for what its nodes still hold"
            )
        return BurstStatus(
            burst=0 if resumed else self.burst.number,
            name=self._writer.name,
            cameras=len(self._cameras),
            instants=instants,
            received=received,
            expected=expected,
            done=done,
            session=None if self.session is None else str(self.session),
            message=message,
            transfer=tuple(camera.transfer(instants) for _, camera in sorted(self._cameras.items())),
        )

    @property
    def folder(self) -> Path:
        """Where the session is written."""
        return self._writer.folder

    def mean_image_bytes(self) -> dict[str, int]:
        """The mean size in bytes of each camera's images, of those that have any."""
        means = {}
        for name, camera in self._cameras.items():
            images = [self._writer.image(name, instant) for instant in camera.instants]
            sizes = [image.bytes for image in images if image is not None]
            if sizes:
                means[name] = sum(sizes) // len(sizes)
        return means

    def stream_opened(self, camera: str) -> None:
        """That camera is connected: its images may take their time."""
        self._camera(camera).streams += 1

    def stream_closed(self, camera: str, now_ns: int) -> None:
        """That camera's stream broke off or was closed."""
        self._camera(camera).streams -= 1
        self._camera(camera).note_heard(now_ns)

    async def accept_report(self, report: CameraReport, now_ns: int) -> tuple[ImageReceipt, ...]:
        """Note what a camera will send, and return what is here of it already.

        Raises BadInputError for a report that is not of this burst.
        """
        camera = self._camera(report.camera.name)
        for instant in (*report.instants, *(missing.instant for missing in report.missing)):
            self._check_instant(instant)
        camera.interrupt()
        async with camera.writing:
            self._check_open()
            if camera.report is None and report.events:
                events = ({"camera": report.camera.name, **event} for event in report.events)
                await self._disk.call(self._writer.add_event, *events)
            planned = plans.camera_plan(report)
            await self._disk.call(self._plan_report, planned)
            camera.report, camera.given_up, camera.silent = planned, "", False
            camera.note_heard(now_ns)
            receipts = await self._disk.call(camera.receipts, self._writer)
        await self.finish_if_complete()
        return receipts

    async def receive_image(self, upload: ImageUpload, payload: AsyncIterator[bytes], now_ns: int) -> str:
        """Save an image as it comes in and return its checksum once it is on disk.

        What came of it stays where the stream breaks off, with NetworkError. Raises BadInputError,
        TryAgainError for a damaged one, DiskFullError; a full disk ends the burst.
        """
        camera = self._camera(upload.record.camera)
        self._check_instant(upload.record.instant)
        self._check_open()
        known = self._writer.image(upload.record.camera, upload.record.instant)
        if known is not None:
            return known.sha256
        try:
            await camera.receive_image(upload, payload, self._writer, self._disk, self._check_open)
        except DiskFullError:
            await self.finish_now("the leader's disk is full")
            raise
        camera.note_heard(now_ns)
        await self.finish_if_complete()
        return upload.record.sha256

    async def give_up_camera(self, name: str, reason: str, *, silent: bool = False) -> None:
        """Wait no longer for a camera; `silent` where it may have its images all the same."""
        camera = self._cameras.get(name)
        if camera is not None and not camera.is_complete():
            camera.given_up, camera.silent = reason, silent
            await self.finish_if_complete()

    async def give_up_silent_cameras(self, lost: Mapping[str, str], now_ns: int) -> None:
        """Wait no longer for cameras without a stream, or lost (name to reason), or stalled."""
        for name, camera in self._cameras.items():
            if reason := camera.why_silent(lost, now_ns):
                await self.give_up_camera(name, reason, silent=True)

    async def finish_now(self, reason: str) -> None:
        """Finish with what has come; `reason` is recorded with the images that are missing."""
        for name in self._cameras:
            await self.give_up_camera(name, reason, silent=True)
        await self.finish_if_complete()

    async def finish_if_complete(self) -> None:
        """Write the manifest once nothing is waited for; harmless before and after."""
        if not self._may_finish():
            return
        async with self._no_image_written():
            if not self._may_finish():
                return
            try:
                self.session = await self._disk.call(self._finish)
            except SimulshotError as error:
                self.message = f"{error}; then: capture-app sessions repair {self.folder}"
                await self._disk.call(self._writer.abort)
            self.finished.set()

    async def suspend(self) -> None:
        """Go away without finishing: `resume` goes on from here."""
        how = f"the next leader goes on, or capture-app sessions repair {self.folder}"
        await self._end(self._writer.abort, f"left unfinished: {how}")

    async def cancel(self, reason: str) -> None:
        """Wait for nothing more: what has come is saved, and without any image there is no session."""
        for name in self._cameras:
            await self.give_up_camera(name, reason)
        await self.finish_if_complete()

    async def _end(self, work: Callable[[], None], message: str) -> None:
        async with self._no_image_written():
            if not self.finished.is_set():
                await self._disk.call(work)
                self.message = message
                self.finished.set()

    def is_empty(self) -> bool:
        """Whether no image has come yet."""
        return not any(camera.instants for camera in self._cameras.values())

    def _camera(self, name: str) -> CameraProgress:
        try:
            return self._cameras[name]
        except KeyError:
            raise BadInputError(f"camera {name!r} is not in burst {self.burst.number}") from None

    def _check_instant(self, instant: int) -> None:
        if not 0 <= instant < len(self.burst.instants_ns):
            raise BadInputError(f"burst {self.burst.number} has no instant {instant}")

    def _check_open(self) -> None:
        if self.finished.is_set():
            raise TryAgainError(f"burst {self.burst.number} is over")

    def _may_finish(self) -> bool:
        return not self.finished.is_set() and all(c.is_complete() for c in self._cameras.values())

    @asynccontextmanager
    async def _no_image_written(self) -> AsyncIterator[None]:
        async with AsyncExitStack() as stack:
            for camera in self._cameras.values():
                await stack.enter_async_context(camera.writing)
            yield

    def _plan_report(self, report: CameraPlan) -> None:
        with self._planning:
            plan = self._writer.plan
            if plan is not None and (changed := plans.add_report(plan, report)) != plan:
                self._writer.set_plan(changed)

    def _finish(self) -> Path | None:
        instants, cameras = len(self.burst.instants_ns), self._cameras.values()
        lost = {} if self._interrupted is None else self._interrupted.lost
        missing = [gap for camera in cameras for gap in camera.missing_images(instants, lost)]
        if missing:
            reasons = sorted({f"{gap.camera}: {gap.reason}" for gap in missing})
            self.message = f"{len(missing)} images are missing ({'; '.join(reasons)})"
        if self.is_empty() and self._interrupted is None and not any(camera.silent for camera in cameras):
            self._writer.discard()
            self.message = f"no image came, so no session was made; {self.message}"
            return None
        return plans.write_manifest(self._writer, self._cameras, plans.burst_record(self.burst), missing)
