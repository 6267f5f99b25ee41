"""A burst on the leader's side: reports and images come in, a session comes out, whatever is missing."""

import asyncio
import threading
from collections.abc import AsyncIterator, Mapping
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path

from capture_app.camera_facts import CameraFacts
from capture_app.errors import BadInputError, DiskFullError, SimulshotError, TryAgainError
from capture_app.node.burst.camera_progress import Share
from capture_app.node.burst.interrupted import Interrupted
from capture_app.node.burst.plans import first_plan, with_report, write_manifest
from capture_app.node.transfer.incoming import Incoming
from capture_app.node.transfer.spool import DiskThreads
from capture_app.node.wire.messages import CameraReport, Held, ImageUpload
from capture_app.node.wire.status import BurstStatus
from capture_app.session.format.manifest import BurstRecord, CameraRecord, MissingImage
from capture_app.session.writing.store import SessionWriter
from capture_app.sync.rig.frame_picks import Burst

PATIENCE_NS = 10_000_000_000
"""A camera that has had no stream open for this long has left its images behind."""
STALL_NS = 180_000_000_000
"""A camera that has a stream open and sends nothing for this long has too."""
AFTER_LAST_INSTANT_NS = 2_000_000_000


class BurstSession:
    """Collects one burst into a session; finished when every camera has delivered or is given up."""

    def __init__(
        self,
        burst: Burst,
        cameras: Mapping[str, CameraFacts],
        writer: SessionWriter,
        *,
        shares: dict[str, Share] | None = None,
    ) -> None:
        """`shares` are those of an earlier run, in the place of the cameras' first ones."""
        self.burst = burst
        self.finished = asyncio.Event()
        self.session: Path | None = None
        self.message = ""
        self._writer = writer
        self._planning = threading.Lock()
        self._on_disk = DiskThreads().run
        self._lost: dict[tuple[str, int], MissingImage] = {}
        """What an earlier finish of this session gave up, and why."""
        self._resumed = False
        begin_ns = burst.instants_ns[-1] + AFTER_LAST_INSTANT_NS
        self._shares = shares or {
            name: Share(CameraRecord(name=name, facts=cameras[name]), begin_ns) for name in burst.clients
        }

    @classmethod
    def resume(cls, folder: Path, heard_ns: int) -> "BurstSession":
        """Go on with a burst that was interrupted or lacks images; its cameras count as heard at `heard_ns`.

        Blocks on the disk. Raises BadInputError where the session has no plan, TryAgainError where another
        process writes it.
        """
        before = Interrupted.read(folder, heard_ns)
        session = cls(before.burst, {}, before.writer, shares=before.shares)
        session._resumed = True
        session._lost = before.lost
        return session

    async def begin(self, leader: int) -> None:
        """Put on disk what this is to become; `leader` is the run of the leader that nodes know it by.

        Raises DiskFullError where there is no room for it.
        """
        cameras = [share.camera for share in self._shares.values()]
        plan = first_plan(self._writer, leader, self.burst.number, self._record, cameras)
        async with self._all_quiet():
            await self._on_disk(self._writer.set_plan, plan)

    @property
    def status(self) -> BurstStatus:
        """How far it is; a burst of an earlier run has no number in this one."""
        instants = len(self.burst.instants_ns)
        received = sum(len(share.instants) for share in self._shares.values())
        expected = len(self._shares) * instants
        done, message = self.finished.is_set(), self.message
        if self._resumed:
            message = f"{self._writer.name} of an earlier run: {received} of {expected} images" + (
                f"; {message}" if message else "" if done else ", waiting for what its nodes still hold"
            )
        return BurstStatus(
            burst=0 if self._resumed else self.burst.number,
            name=self._writer.name,
            cameras=len(self._shares),
            instants=instants,
            received=received,
            expected=expected,
            done=done,
            session=None if self.session is None else str(self.session),
            message=message,
        )

    @property
    def folder(self) -> Path:
        """Where the session is written."""
        return self._writer.folder

    def image_bytes(self) -> dict[str, int]:
        """The mean size in bytes of each camera's images, of those that have any."""
        means = {}
        for name, share in self._shares.items():
            images = [self._writer.image(name, instant) for instant in share.instants]
            sizes = [image.bytes for image in images if image is not None]
            if sizes:
                means[name] = sum(sizes) // len(sizes)
        return means

    def stream_opened(self, camera: str) -> None:
        """That camera is connected: its images may take their time."""
        self._share(camera).streams += 1

    def stream_closed(self, camera: str, now_ns: int) -> None:
        """That camera's stream broke off or was closed."""
        share = self._share(camera)
        share.streams -= 1
        share.heard_ns = max(share.heard_ns, now_ns)

    async def take_report(self, report: CameraReport, now_ns: int) -> tuple[Held, ...]:
        """Note what a camera will send, and return what is here of it already.

        Raises BadInputError for a report that is not of this burst.
        """
        share = self._share(report.camera.name)
        for instant in (*report.instants, *(missing.instant for missing in report.missing)):
            self._check_instant(instant)
        if share.incoming is not None:
            # A stream that the node has left may not have noticed yet.
            share.incoming.close()
        async with share.writing:
            self._must_be_open()
            if share.report is None and report.events:
                events = ({"camera": report.camera.name, **event} for event in report.events)
                await self._on_disk(self._writer.add_event, *events)
            await self._on_disk(self._note_report, report)
            share.report, share.given_up, share.silent = report, "", False
            share.heard_ns = max(share.heard_ns, now_ns)
            held = await self._on_disk(share.held, self._writer)
        await self.finish_if_complete()
        return held

    async def take_image(self, upload: ImageUpload, payload: AsyncIterator[bytes], now_ns: int) -> str:
        """Save an image as it comes in and return its checksum once it is on disk.

        What came of it stays where the stream breaks off, with NetworkError. Raises BadInputError,
        TryAgainError for a damaged one, DiskFullError; a full disk ends the burst.
        """
        share = self._share(upload.record.camera)
        self._check_instant(upload.record.instant)
        self._must_be_open()
        known = self._writer.image(upload.record.camera, upload.record.instant)
        if known is not None:
            return known.sha256
        try:
            await self._receive(share, upload, payload)
        except DiskFullError:
            await self.stop("the leader's disk is full")
            raise
        share.heard_ns = max(share.heard_ns, now_ns)
        await self.finish_if_complete()
        return upload.record.sha256

    async def give_up(self, camera: str, reason: str, *, silent: bool = False) -> None:
        """Wait no longer for a camera; `silent` where it may have its images all the same."""
        share = self._shares.get(camera)
        if share is not None and not share.is_complete():
            share.given_up, share.silent = reason, silent
            await self.finish_if_complete()

    async def give_up_silent(self, lost: Mapping[str, str], now_ns: int) -> None:
        """Wait no longer for cameras without a stream, or lost (name to reason), or stalled."""
        for name, share in self._shares.items():
            silent_ns = now_ns - share.heard_ns
            if silent_ns >= PATIENCE_NS and (not share.streams or name in lost):
                await self.give_up(name, lost.get(name, "it sent nothing"), silent=True)
            elif silent_ns >= STALL_NS:
                await self.give_up(name, f"it sent nothing for {STALL_NS // 10**9} s", silent=True)

    async def stop(self, reason: str) -> None:
        """Finish with what is there."""
        for name in self._shares:
            await self.give_up(name, reason, silent=True)
        await self.finish_if_complete()

    async def finish_if_complete(self) -> None:
        """Write the manifest once nothing is waited for; harmless before and after."""
        if self.finished.is_set() or not all(share.is_complete() for share in self._shares.values()):
            return
        async with self._all_quiet():
            if self.finished.is_set() or not all(share.is_complete() for share in self._shares.values()):
                return
            try:
                self.session = await self._on_disk(self._finish)
            except SimulshotError as error:
                self.message = f"{error}; then: capture-app sessions repair {self.folder}"
                await self._on_disk(self._writer.abort)
            self.finished.set()

    async def leave(self) -> None:
        """Go away without finishing: `resume` goes on from here."""
        async with self._all_quiet():
            if not self.finished.is_set():
                await self._on_disk(self._writer.abort)
                self.message = (
                    f"left unfinished: the next leader goes on, or capture-app sessions repair {self.folder}"
                )
                self.finished.set()

    async def cancel(self, reason: str) -> None:
        """End a burst that never began, and delete its folder."""
        async with self._all_quiet():
            if not self.finished.is_set():
                await self._on_disk(self._writer.discard)
                self.message = reason
                self.finished.set()

    def is_empty(self) -> bool:
        """Whether no image has come yet."""
        return not any(share.instants for share in self._shares.values())

    def _share(self, camera: str) -> Share:
        try:
            return self._shares[camera]
        except KeyError:
            raise BadInputError(f"camera {camera!r} is not in burst {self.burst.number}") from None

    def _check_instant(self, instant: int) -> None:
        if not 0 <= instant < len(self.burst.instants_ns):
            raise BadInputError(f"burst {self.burst.number} has no instant {instant}")

    def _must_be_open(self) -> None:
        if self.finished.is_set():
            raise TryAgainError(f"burst {self.burst.number} is over")

    @asynccontextmanager
    async def _all_quiet(self) -> AsyncIterator[None]:
        async with AsyncExitStack() as stack:
            for share in self._shares.values():
                await stack.enter_async_context(share.writing)
            yield

    async def _receive(self, share: Share, upload: ImageUpload, payload: AsyncIterator[bytes]) -> None:
        incoming = Incoming(self.folder, upload)
        async with share.writing:
            self._must_be_open()
            if share.incoming is not None:
                share.incoming.close()
            share.incoming = incoming
            await self._on_disk(incoming.open)
        try:
            async for chunk in payload:
                await self._on_disk(incoming.add, chunk)
        finally:
            incoming.close()
        async with share.writing:
            self._must_be_open()
            if upload.record.instant not in share.instants:
                await self._on_disk(self._keep, incoming)
                share.instants.add(upload.record.instant)

    def _keep(self, incoming: Incoming) -> None:
        upload, record = incoming.upload, incoming.upload.record
        truth = incoming.take_apart()
        # The truth first: an image that is on disk is one that needs nothing more.
        if truth and upload.true_ns is not None:
            self._writer.add_ground_truth(record.camera, record.instant, truth, upload.true_ns)
        self._writer.add_received(record, incoming.file)

    def _note_report(self, report: CameraReport) -> None:
        with self._planning:
            plan = self._writer.plan
            if plan is not None and (changed := with_report(plan, report)) != plan:
                self._writer.set_plan(changed)

    def _finish(self) -> Path | None:
        instants = len(self.burst.instants_ns)
        missing = [gap for share in self._shares.values() for gap in share.missing(instants, self._lost)]
        if missing:
            reasons = sorted({f"{gap.camera}: {gap.reason}" for gap in missing})
            self.message = f"{len(missing)} images are missing ({'; '.join(reasons)})"
        if self.is_empty() and not self._resumed and not any(share.silent for share in self._shares.values()):
            self._writer.discard()
            self.message = f"no image came, so no session was made; {self.message}"
            return None
        return write_manifest(self._writer, self._shares, self._record, missing)

    @property
    def _record(self) -> BurstRecord:
        return BurstRecord(
            instants_ns=self.burst.instants_ns,
            period_ns=self.burst.period_ns,
            requested_ns=self.burst.requested_ns,
        )
