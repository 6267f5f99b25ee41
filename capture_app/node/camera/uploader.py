"""Brings a node's bursts to the leader and keeps each image until the leader has it safely on disk."""

import asyncio
import contextlib
from collections import deque
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from capture_app.cameras.frames import CapturedFrame, lower_priority
from capture_app.errors import CameraError, NetworkError, SimulshotError
from capture_app.net.address import Address
from capture_app.net.channel import Channel, connect
from capture_app.node.camera.burst_sender import BurstSender, PostponedError
from capture_app.node.camera.burst_upload import BurstUpload, Spool, encode_frame
from capture_app.node.news import Log
from capture_app.node.wire.messages import CameraReport, FromLeader, ImageUpload, NodeStream, Refusal
from capture_app.session.format.manifest import MissingImage
from capture_app.sync.rig.frame_selection import SelectedFrame
from capture_app.text import count
from capture_app.trust.trust import Trust

RETRY_S = (0.5, 1.0, 2.0, 4.0)
SPACE_EVERY_S = 30.0
MAX_WAITING_BURSTS = 64


class Uploader:
    """Encodes bursts into the spool, and sends them in their order over a stream that it reopens."""

    def __init__(
        self,
        camera: str,
        instance: int,
        log: Log,
        spool: Spool | None = None,
        *,
        retry_s: Sequence[float] = RETRY_S,
        trust: Trust | None = None,
    ) -> None:
        """Speak for a camera, by the run that its node joins with, to leaders known by `trust`.

        `retry_s` are the waits after the first failed stream, the second and so on; the last one stays.
        """
        self._log = log
        self._trust = trust
        self._opening = NodeStream(camera=camera, instance=instance)
        self.spool = spool
        self.leader: Address | None = None
        self._run: int | None = None
        self._retry_s = retry_s
        self._waiting: deque[BurstUpload] = deque()
        self._refused: deque[BurstUpload] = deque(maxlen=MAX_WAITING_BURSTS)
        self._news = asyncio.Event()
        self._to_encode = asyncio.Event()
        self._to_sync = asyncio.Event()
        self._space_is_due = False
        self._thread = ThreadPoolExecutor(1, "encode", initializer=lower_priority)
        self._stream: Channel[Any] | None = None

    @property
    def is_busy(self) -> bool:
        """Whether something is being encoded or sent, rather than waiting for the leader or for news."""
        return self._stream is not None or any(burst.frames for burst in self._waiting)

    def load_spool(self) -> None:
        """Take on what an earlier run of this node has left in the spool. Raises SimulshotError."""
        for spooled in self.spool.open() if self.spool is not None else ():
            try:
                report, images = spooled.read_report(), deque(spooled.read_images())
            except SimulshotError as error:
                self._log.say(f"left in the spool: {error}")
                continue
            if not images:
                spooled.remove()
                continue
            waiting = count(len(images), "image")
            self._log.say(f"burst {report.burst}: {waiting} still in {spooled.folder}")
            report = _with_images(report, images)
            self._waiting.append(BurstUpload(report, deque(), images, spooled=spooled))

    def add_burst(self, burst: BurstUpload) -> None:
        """Take on a burst; the oldest is given up where a leader has been away for too many."""
        self._waiting.append(burst)
        if len(self._waiting) > MAX_WAITING_BURSTS:
            given_up = self._waiting.popleft()
            where = f"; what it has is in {given_up.spooled.folder}" if given_up.spooled else ""
            self._log.say(f"burst {given_up.report.burst} given up: the leader is away for too long{where}")
        self._news.set()
        self._to_encode.set()

    def extend_burst(
        self,
        leader: int,
        burst: int,
        frames: Iterable[SelectedFrame[CapturedFrame]],
        missing: Iterable[MissingImage],
        *,
        over: int = 0,
        ended: bool = False,
    ) -> None:
        """Add further instants to a burst that was taken on before, where they are still of use.

        `over` and `ended` as for `BurstUpload.extend`.
        """
        for upload in self._uploads_of(leader, burst):
            upload.extend(frames, missing, over=over, ended=ended)
        self._news.set()
        self._to_encode.set()

    def cancel_burst(self, leader: int, burst: int) -> None:
        """Let go of a burst: its leader wants nothing of it any more."""
        for upload in self._uploads_of(leader, burst):
            upload.end()
            self._log.say(f"burst {burst} was cancelled")
        self._news.set()

    async def run(self) -> None:
        """Encode and send until cancelled."""
        try:
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self._encode_all())
                tasks.create_task(self._send_all())
                tasks.create_task(self._sync_spool())
                tasks.create_task(self._watch_space())
        finally:
            self._thread.shutdown(wait=False, cancel_futures=True)

    def close(self) -> None:
        """Let another node use the spool."""
        if self.spool is not None:
            self.spool.close()

    def set_leader(self, leader: Address, run: int | None = None) -> None:
        """Send images to that address from now on; what was refused before is offered again.

        `run` is the leader's, of whose bursts alone it may say that they are to be forgotten.
        """
        if leader != self.leader and self._stream is not None:
            # Nobody may ever close the stream to a relay whose plug was pulled.
            self._stream.abort()
        self.leader, self._run = leader, run
        self._waiting.extendleft(reversed(self._refused))
        self._refused.clear()
        self._space_is_due = True
        self._news.set()

    async def _encode_all(self) -> None:
        while True:
            self._to_encode.clear()
            burst = next((burst for burst in self._waiting if burst.frames), None)
            if burst is None:
                await self._keep_ends()
                await self._to_encode.wait()
                continue
            spooling = burst.spooling
            await self._encode_next(burst)
            self._space_is_due |= burst.spooling != spooling
            if burst.is_over and burst.spooled is not None:
                await asyncio.to_thread(burst.spooled.remove)
            self._news.set()
            self._to_sync.set()

    async def _encode_next(self, burst: BurstUpload) -> None:
        """Encode the first frame of a burst that has one, and move it to its images."""
        picked, image = burst.frames[0], None
        try:
            loop = asyncio.get_running_loop()
            image = await loop.run_in_executor(self._thread, self._encode, burst, picked)
        except CameraError as error:
            burst.report_lost([picked.instant], str(error))
            self._log.say(f"burst {burst.report.burst}: instant {picked.instant} is lost: {error}")
        # While it was encoded, the leader may have refused the burst.
        if burst.frames and burst.frames[0] is picked:
            burst.frames.popleft()
            if image is not None:
                burst.images.append(image)

    def _encode(self, burst: BurstUpload, picked: SelectedFrame[CapturedFrame]) -> ImageUpload:
        """Encode a frame into the spool where there is room, else into memory; in a thread of its own."""
        image, data = encode_frame(burst.report, picked, with_truth=not burst.video)
        # It can be sent from here at once, while the spool's disk takes its time.
        burst.in_memory[picked.instant] = data
        if self.spool is None or not burst.spooling:
            return image
        try:
            if burst.spooled is None:
                burst.spooled = self.spool.create_burst(burst.report_to_keep())
            burst.spooled.add_image(image, data)
        except SimulshotError as error:
            self._note_useless_spool(burst, error)
        else:
            burst.unsynced[picked.instant] = image
        return image

    def _note_useless_spool(self, burst: BurstUpload, error: SimulshotError) -> None:
        """Keep a burst in memory from now on, as the spool cannot take it; the next one tries again."""
        burst.spooling = False
        self._log.say(f"burst {burst.report.burst} is kept in memory until the leader has it: {error}")

    async def _keep_ends(self) -> None:
        """Keep in the spool what is missing of bursts that have ended."""
        for burst in tuple(self._waiting):
            has_ended = burst.ended and not burst.is_over
            if has_ended and not burst.end_is_kept and burst.spooled is not None:
                burst.end_is_kept = True
                with contextlib.suppress(SimulshotError):
                    await asyncio.to_thread(burst.spooled.write_report, burst.report_to_keep())

    async def _sync_spool(self) -> None:
        """Sync the spool for all images that were written to it during the sync before."""
        while True:
            await self._to_sync.wait()
            self._to_sync.clear()
            for burst in tuple(self._waiting):
                images, spooled = dict(burst.unsynced), burst.spooled
                if not images or spooled is None:
                    continue
                try:
                    # What goes on to the leader at once is here for too short a time to be worth a sync: it
                    # outlives this process, and a power cut of this machine would end the stream anyway.
                    if not burst.streamed or self._stream is None:
                        await asyncio.to_thread(spooled.sync, images.values())
                except SimulshotError as error:
                    burst.unsynced.clear()
                    self._note_useless_spool(burst, error)
                    continue
                for instant in images:
                    if burst.unsynced.pop(instant, None) is not None:
                        burst.in_memory.pop(instant, None)

    async def _send_all(self) -> None:
        failures = 0
        while True:
            while self.leader is None or not (self._waiting or self._space_is_due):
                self._news.clear()
                await self._news.wait()
            try:
                async with (
                    await connect(self.leader, FromLeader, trust=self._trust) as channel,
                    contextlib.aclosing(BurstSender(channel, self._news, self._log, self._waiting)) as sender,
                ):
                    self._stream = channel
                    if isinstance(refusal := await sender.ask(self._opening), Refusal):
                        raise NetworkError(refusal.what, hint=refusal.hint)
                    while self._waiting or self._space_is_due:
                        if self._space_is_due:
                            self._space_is_due = False
                            if self.spool is not None:
                                await sender.ask(await asyncio.to_thread(self.spool.look))
                        else:
                            await self._send_burst(sender, self._waiting[0])
                            failures = 0
            except NetworkError as error:
                if isinstance(error, PostponedError):
                    self._waiting.rotate(-1)
                if not failures:
                    self._log.say(f"images wait: {error}")
                await asyncio.sleep(self._retry_s[min(failures, len(self._retry_s) - 1)])
                failures += 1
            finally:
                self._stream = None

    async def _send_burst(self, sender: BurstSender, burst: BurstUpload) -> None:
        refusal = await sender.send_burst(burst)
        if refusal is None and burst.is_picking and not burst.is_over:
            self._waiting.rotate(-1)
            return
        forget = refusal is not None and refusal.forget and burst.report.leader == self._run
        if refusal is None or forget:
            burst.end()
        if refusal is None:
            if burst.spooled is not None:
                await asyncio.to_thread(burst.spooled.remove)
            self._space_is_due = self.spool is not None
        else:
            burst.frames.clear()
            kept = ""
            if burst.spooled is not None and forget:
                await asyncio.to_thread(burst.spooled.remove)
            elif burst.spooled is not None:
                self._refused.append(burst)
                kept = f"; its images stay in {burst.spooled.folder}"
            self._log.say(f"burst {burst.report.burst} given up: {refusal.what}{kept}")
        with contextlib.suppress(ValueError):
            self._waiting.remove(burst)

    def _uploads_of(self, leader: int, burst: int) -> list[BurstUpload]:
        of = leader, burst
        return [u for u in (*self._waiting, *self._refused) if (u.report.leader, u.report.burst) == of]

    async def _watch_space(self) -> None:
        while self.spool is not None:
            await asyncio.sleep(SPACE_EVERY_S)
            self._space_is_due = True
            self._news.set()


def _with_images(report: CameraReport, images: Iterable[ImageUpload]) -> CameraReport:
    """A report with the spare instants, too, that were picked after it was written."""
    here = {image.record.instant for image in images}
    if report.plan.picking or report.plan.picked is not None:
        # What is not here any more the leader has: it was sent as it came.
        return report.with_plan(instants=tuple(sorted(here)), picking=False)
    instants = sorted({*report.plan.instants, *here})
    missing = tuple(gap for gap in report.plan.missing if gap.instant not in instants)
    return report.with_plan(instants=tuple(instants), missing=missing)
