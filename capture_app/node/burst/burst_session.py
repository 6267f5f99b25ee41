"""A burst on the leader's side: reports and images come in, a session comes out, whatever is missing.

How far a burst is, for whoever looks.
"""

import asyncio
from collections.abc import AsyncIterator, Collection, Coroutine, Mapping, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from typing import Any

from msgspec.structs import replace

from capture_app.camera_facts import CameraFacts
from capture_app.errors import BadInputError, DiskError, DiskFullError, SimulshotError, TryAgainError
from capture_app.node.burst import plans
from capture_app.node.burst.camera_share import CameraProgress, DiskThreads
from capture_app.node.burst.instant_choice import InstantChoice
from capture_app.node.burst.intake import ImageCommits, ImageIntake, shortened
from capture_app.node.burst.plans import Settlement
from capture_app.node.wire.messages import CameraReport, ImageUpload, ReportAck
from capture_app.node.wire.status import BurstStatus
from capture_app.session.format.manifest import CameraRecord
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.sync.rig.frame_picks import Burst
from capture_app.text import count

SAID_AFTER_S = 1.0
"""A wait for the disk that takes longer is told."""


def waiting_text(commits: ImageCommits, undecided: Sequence[str]) -> str:
    """What a burst waits for: the disk, or cameras that have not told what they have; empty for neither."""
    images, seconds = commits.waiting()
    if seconds >= SAID_AFTER_S:
        return f"waiting for the disk: {count(images, 'image')}, {seconds:.0f} s"
    return f"waiting to hear from {', '.join(undecided)}" if undecided else ""


def disk_reason(error: DiskError) -> str:
    """Why images are missing when the leader's disk failed."""
    return "the leader's disk is full" if isinstance(error, DiskFullError) else f"at the leader: {error.what}"


def burst_status(
    burst: Burst,
    writer: SessionWriter,
    cameras: Mapping[str, CameraProgress],
    choice: InstantChoice,
    *,
    message: str,
    done: bool,
    session: Path | None,
    resumed: bool,
) -> BurstStatus:
    """How far a burst is; one of an earlier run has no number in this one."""
    # Nobody knows how long a recording will be: of one under way as much is expected as any camera has sent.
    so_far = max((camera.instants.end for camera in cameras.values()), default=0)
    instants = so_far if burst.video and not done else burst.frames
    transfer = tuple(camera.transfer(instants) for _, camera in sorted(cameras.items()))
    received, expected = sum(t.received for t in transfer), sum(t.expected for t in transfer)
    if resumed:
        message = f"{writer.name} of an earlier run: {received} of {expected} images" + (
            f"; {message}" if message else "" if done else ", waiting for what its nodes still hold"
        )
    return BurstStatus(
        burst=0 if resumed else burst.number,
        name=writer.name,
        cameras=len(cameras),
        instants=instants,
        received=received,
        expected=expected,
        done=done,
        session=None if session is None else str(session),
        message=message,
        transfer=transfer,
        recording=burst.video,
        skipped=choice.skipped({name: camera.report for name, camera in cameras.items()}),
    )


def mean_image_bytes(writer: SessionWriter, cameras: Mapping[str, CameraProgress]) -> dict[str, int]:
    """The mean size in bytes of each camera's images, of those that have any."""
    means = {video.camera: video.bytes // video.frames for video in writer.videos.records() if video.frames}
    for name, camera in cameras.items():
        instants = () if name in means else camera.instants
        images = [writer.image(name, instant) for instant in instants]
        sizes = [image.bytes for image in images if image is not None]
        if sizes:
            means[name] = sum(sizes) // len(sizes)
    return means


AFTER_LAST_INSTANT_NS = 2_000_000_000


class BurstSession:
    """Collects one burst into a session; finished when every camera has delivered or is given up."""

    def __init__(
        self,
        burst: Burst,
        cameras: Mapping[str, CameraFacts],
        writer: SessionWriter,
        disk: DiskThreads,
        *,
        interrupted: plans.InterruptedBurst | None = None,
        hasty: Collection[str] = (),
    ) -> None:
        """Begin with these cameras, or go on where an earlier run left off; `hasty`: wait less for those."""
        self.burst = burst
        self.finished = asyncio.Event()
        self.session: Path | None = None
        self.message = self.trouble = ""
        """Trouble: why the leader's disk takes nothing of it at present; nodes keep it, and ask again."""
        self._writer = writer
        self._disk = disk
        self._interrupted = interrupted
        begin_ns = burst.instants_ns[0 if burst.streamed else -1] + AFTER_LAST_INSTANT_NS
        self._cameras = {
            name: CameraProgress(CameraRecord(name=name, facts=of), begin_ns, was_silent=name in hasty)
            for name, of in cameras.items()
            if name in burst.clients
        }
        self._choice = InstantChoice(burst)
        if interrupted is not None:
            self._cameras, self._choice = interrupted.cameras, interrupted.choice
        self._plan = plans.SharedPlan(writer, disk)
        self._settlement = Settlement(self._choice, self._plan, self._cameras)
        self._background: set[asyncio.Task[None]] = set()
        self._intake = ImageIntake(
            writer,
            disk,
            self._choice,
            self._camera,
            check_open=self._check_open,
            on_saved=lambda: self._spawn(self.finish_if_complete()),
            on_failure=lambda error: self._spawn(self.finish_now(disk_reason(error))),
        )

    @classmethod
    def resume(cls, folder: Path, heard_ns: int, disk: DiskThreads) -> "BurstSession":
        """Go on with a burst that was interrupted or lacks images; its cameras count as heard at `heard_ns`.

        Blocks on the disk. Raises BadInputError where the session has no plan, TryAgainError where another
        process writes it.
        """
        before = plans.InterruptedBurst.read(folder, heard_ns)
        return cls(before.burst, {}, before.writer, disk, interrupted=before)

    async def write_plan(self, leader: int, note: str = "") -> None:
        """Put on disk what this is to become; `leader` is the run of the leader that nodes know it by.

        Raises DiskFullError where there is no room for it.
        """
        self._plan.begin(leader, self.burst, note)
        await self._settlement.save_plan()

    @property
    def status(self) -> BurstStatus:
        """How far it is; a burst of an earlier run has no number in this one."""
        done = self.finished.is_set()
        waiting = (
            "" if done else self.trouble or waiting_text(self._intake.commits, self._settlement.undecided)
        )
        return burst_status(
            self.burst,
            self._writer,
            self._cameras,
            self._choice,
            message=self.message or waiting,
            done=done,
            session=self.session,
            resumed=self._interrupted is not None,
        )

    @property
    def folder(self) -> Path:
        """Where the session is written."""
        return self._writer.folder

    def mean_image_bytes(self) -> dict[str, int]:
        """The mean size in bytes of each camera's images, of those that have any."""
        return mean_image_bytes(self._writer, self._cameras)

    def stream_opened(self, camera: str) -> None:
        """That camera is connected: its images may take their time."""
        self._camera(camera).streams += 1

    def stream_closed(self, camera: str, now_ns: int) -> None:
        """That camera's stream broke off or was closed."""
        self._camera(camera).streams -= 1
        self._camera(camera).note_heard(now_ns)

    async def accept_report(self, report: CameraReport, now_ns: int, *, wait_s: float = 0.0) -> ReportAck:
        """Note what a camera will send; return what of it is wanted, and is here already.

        While that depends on other cameras it waits up to `wait_s` for them. Raises BadInputError for a
        report that is not of this burst, DiskError while the disk does not take it.
        """
        camera = self._camera(report.camera.name)
        if self.burst.streamed:
            # It may have heard late that the burst ends earlier.
            report = replace(report, instants=tuple(n for n in report.instants if n < self.burst.frames))
        self._choice.check_ordered([*report.instants, *(missing.instant for missing in report.missing)])
        camera.interrupt()
        async with camera.writing:
            self._check_open()
            first = camera.report is None
            if first and report.events:
                events = ({"camera": report.camera.name, **event} for event in report.events)
                await self._disk.call(self._writer.add_event, *events)
            known = camera.report if self._interrupted else None
            camera.report, camera.given_up, camera.silent = plans.camera_plan(report, known), "", False
            camera.note_heard(now_ns, advanced=first or not self._choice.is_settled)
            await self._settlement.settle()
            if self._choice.is_settled:
                await self._settlement.save_plan()
        if not await self._settlement.wait(wait_s):
            return ReportAck(undecided=True)
        receipts = await self._disk.call(camera.receipts, self._writer, self._choice)
        await self.finish_if_complete()
        return ReportAck(receipts=receipts, wanted=self._choice.wanted)

    async def take_image(
        self, upload: ImageUpload, payload: AsyncIterator[bytes], now_ns: int
    ) -> "asyncio.Future[str]":
        """Take an image in as it comes; the future that is returned has its checksum once it is on disk.

        What came of it stays where the stream breaks off, with NetworkError. Raises BadInputError,
        TryAgainError for a damaged one, DiskFullError, as does the future; a full disk ends the burst.
        """
        return await self._intake.take(self.burst, upload, payload, now_ns)

    async def end(self, burst: Burst) -> None:
        """Wait for no instants beyond those of `burst`: it ends earlier than it was ordered."""
        self.burst = burst
        self._choice.end(burst)
        self._plan.end(burst)
        await self._settlement.save_plan()
        await self.finish_if_complete()

    async def give_up_camera(self, name: str, reason: str, *, silent: bool = False) -> None:
        """Wait no longer for a camera; `silent` where it may have its images all the same."""
        camera = self._cameras.get(name)
        if camera is None or camera.is_complete(self._choice):
            return
        camera.given_up, camera.silent = reason, silent
        try:
            await self._settlement.settle()
        except SimulshotError as error:
            # No node may hear of instants that a crash would make others of.
            self._choice.settle_without_reports()
            for other in self._cameras.values():
                other.given_up = other.given_up or error.what
        await self.finish_if_complete()

    async def give_up_silent_cameras(self, lost: Mapping[str, str], now_ns: int) -> None:
        """Wait no longer for cameras without a stream, or lost (name to reason), or stalled."""
        for name, camera in self._cameras.items():
            camera.note_arrivals(now_ns)
            if reason := camera.why_silent(lost, now_ns):
                await self.give_up_camera(name, reason, silent=True)

    async def finish_now(self, reason: str, *, silent: bool = True) -> None:
        """Finish with what has come; `reason` is recorded with the images that are missing."""
        for name in self._cameras:
            await self.give_up_camera(name, reason, silent=silent)
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
        async with self._no_image_written():
            if not self.finished.is_set():
                await self._disk.call(self._writer.abort)
                how = f"the next leader goes on, or capture-app sessions repair {self.folder}"
                self.message = f"left unfinished: {how}"
                self.finished.set()

    async def cancel(self, reason: str) -> None:
        """Wait for nothing more: what has come is saved, and without any image there is no session."""
        await self.finish_now(reason, silent=False)

    def silent_cameras(self) -> set[str]:
        """Those that have brought nothing, and were given up for their silence."""
        return {name for name, of in self._cameras.items() if of.silent and not of.instants}

    def is_empty(self) -> bool:
        """Whether no image has come yet."""
        return not any(camera.instants for camera in self._cameras.values())

    def _camera(self, name: str) -> CameraProgress:
        if name not in self._cameras:
            raise BadInputError(f"camera {name!r} is not in burst {self.burst.number}")
        return self._cameras[name]

    def _check_open(self) -> None:
        if self.finished.is_set():
            raise TryAgainError(f"burst {self.burst.number} is over")

    def _spawn(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.create_task(work)
        self._background.add(task)
        task.add_done_callback(self._background.discard)

    def _may_finish(self) -> bool:
        return not self.finished.is_set() and all(
            camera.is_complete(self._choice) for camera in self._cameras.values()
        )

    @asynccontextmanager
    async def _no_image_written(self) -> AsyncIterator[None]:
        async with AsyncExitStack() as stack:
            for camera in self._cameras.values():
                await stack.enter_async_context(camera.writing)
            await self._intake.commits.wait_until_idle()
            yield

    def _finish(self) -> Path | None:
        if self.burst.video:
            # Without an end, or cut off by one, it lasts as long as any camera has recorded.
            self.burst = shortened(self.burst, self._cameras)
            self._choice.end(self.burst)
        lost = {} if self._interrupted is None else self._interrupted.lost
        missing = [gap for c in self._cameras.values() for gap in c.missing_images(self._choice, lost)]
        burst = self._choice.record(self._settlement.reports)
        self.message = plans.result_text(burst, missing)
        silent = any(camera.silent for camera in self._cameras.values())
        if self.is_empty() and self._interrupted is None and not silent:
            self._writer.discard()
            self.message = f"no image came, so no session was made; {self.message}"
            return None
        return plans.write_manifest(self._writer, self._cameras, burst, missing)
