"""Upload of a node's bursts: each image is stored until the leader has it safely on disk."""

import asyncio
import contextlib
from collections import deque
from collections.abc import Collection, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

from msgspec.structs import replace

from capture_app.cameras.frames import CapturedFrame
from capture_app.common.address import Address
from capture_app.common.errors import (
    CameraError,
    DamagedImageError,
    DiskError,
    NetworkError,
    SimulshotError,
)
from capture_app.common.tasks import end, has_come
from capture_app.common.text import count
from capture_app.common.timeouts import UPLOAD_ANSWER_TIMEOUT_S
from capture_app.net.asking import next_message
from capture_app.net.channel import Channel, connect
from capture_app.node.camera.burst_upload import Upload, UploadInput, UploadState, encode_frame
from capture_app.node.camera.spool import Spool, SpoolFolder, folder_name, unknown_in
from capture_app.protocol.log import Log
from capture_app.protocol.messages import (
    MAX_BATCH_IMAGES,
    CameraReport,
    FromLeader,
    ImageAck,
    ImageBatch,
    ImageUpload,
    NodeStream,
    Refusal,
    ReportAck,
    SpoolSpace,
)
from capture_app.session.format.manifest import MAX_MOVES, PhaseMove, WidenedTimes
from capture_app.sync.rig.frame_selection import FramesSelected, SelectedFrame
from capture_app.trust.identity import is_proven
from capture_app.trust.trust import Trust

RETRY_S = (0.5, 1.0, 2.0, 4.0)
REFUSED_S = (*RETRY_S, 8.0, 16.0)
"""Delays before a burst is offered again whose images the leader cannot save at present: longer than those of
a stream, as each offer costs the link the images on their way."""
SPACE_EVERY_S = 30.0
OFFER_AGAIN_S = 300.0
"""Interval at which refused bursts are offered again: a person may have moved their session back."""
SAY_AFTER_S = 5.0
"""Time without an answer of the leader after which that is reported; the stream breaks off much later."""
MAX_WAITING_BURSTS = 64
MAX_NAMED = 5
"""Maximum number of foreign files that are named at the start."""
MAX_IN_FLIGHT, MAX_BYTES_IN_FLIGHT = 64, 16 << 20
"""Maximum number and size of unacknowledged images, because the leader syncs its disk for many at a time."""
UNSYNCED_S = 1.0
"""Images of a streamed burst that the leader does not have by then are synced to the node's disk."""
ENCODE_EVERY_S = 0.25
"""Interval at which frames of a streamed burst are stored; those of others are stored one by one."""
ASK_AGAIN_S, MAX_DOUBLINGS = 0.05, 4
"""Delay before a burst that depends on other cameras is reported again, for each burst that waits here; it
doubles each time, to 0.8 s."""
LARGE_ARE_LOST = (
    "it answered a short message before: if it runs, the path may drop large packets, where a smaller MTU"
    " helps: sudo ip link set dev wlan0 mtu 1280"
)

A = TypeVar("A", ImageAck, ReportAck)


class Sender:
    """Sender of bursts over one open stream to the leader; `changed` is set whenever there is more to send.

    It reports every burst before it sends further images, so that the leader knows what this node holds.
    """

    def __init__(
        self,
        channel: Channel[Any],
        changed: asyncio.Event,
        log: Log,
        bursts: Collection[Upload],
        roots: Collection[str],
    ) -> None:
        """Create a sender over one stream; `bursts` are all that this node has.

        `roots` are, below a relay, pins of the rig's leaders: one of them must have signed the answers to a
        burst.
        """
        self._channel, self._changed, self._log = channel, changed, log
        self._bursts, self.roots = bursts, roots
        self._in_flight: deque[tuple[Upload, ImageBatch]] = deque()
        """Batches that are not acknowledged."""
        self._answer: asyncio.Task[FromLeader] | None = None
        for burst in bursts:
            # A reconnected leader still has what it acknowledged; only the stream's own state is new.
            if burst.state is not UploadState.REFUSED:
                burst.reopen()

    async def aclose(self) -> None:
        """Stop waiting for answers."""
        if self._answer is not None:
            await end(self._answer)

    async def ask(
        self,
        message: NodeStream | CameraReport | SpoolSpace,
    ) -> ReportAck | Refusal:
        """Send a message and return the leader's answer.

        Raises NetworkError where the stream breaks off or the leader does not answer.
        """
        await self._channel.send(message, stall_s=UPLOAD_ANSWER_TIMEOUT_S)
        return await self._next_answer(ReportAck)

    async def next_ended(self) -> tuple[Upload, Refusal | None]:
        """Send all bursts while they are encoded, until one is over; return it, and any final refusal.

        A burst is over when the leader has all it requests. One that the leader cannot take yet is offered
        again later, while the others go on. Raises NetworkError where the stream breaks off.
        """
        now = asyncio.get_running_loop().time
        while True:
            self._changed.clear()
            refused: tuple[Upload, Refusal] | None = None
            if (ended := next((burst for burst in self._bursts if burst.has_ended), None)) is not None:
                await self._take_all_answers()
                if not ended.has_ended:
                    continue  # its recording was taken up again meanwhile
                disputed = ", ".join(str(image.record.instant) for image in ended.disputed)
                what = f"the leader has different images of instants {disputed}"
                return ended, Refusal(what=what) if disputed and ended.state is UploadState.SENDING else None
            if unreported := next(
                (upload for upload in self._bursts if upload.must_be_reported(now())), None
            ):
                refused = await self._take_all_answers() or await self._report_burst(unreported)
            elif (unsent := self._next_unsent()) is not None:
                refused = await self._send_images(*unsent)
            elif self._in_flight:
                refused = await self._take_answer()
            else:
                # Until something has changed, or the leader is to be asked again about a burst.
                due = [upload.due_s for upload in self._bursts if upload.state is UploadState.WAITING]
                await has_come(self._changed, max(0.0, min(due) - now()) if due else None)
            if refused is not None:
                # What else was refused is sent, and refused, again.
                await self._take_all_answers()
                burst, refusal = refused
                if not refusal.retry:
                    return burst, refusal
                self._log.say_once(f"images of burst {burst.report.burst} wait: {refusal.as_error()}")
                burst.put_off(now() + REFUSED_S[min(burst.attempts, len(REFUSED_S) - 1)])

    def _next_unsent(self) -> tuple[Upload, list[ImageUpload]] | None:
        """Return the next images to send now; bursts that are being captured wait for those that are over."""
        size = sum(batch.bytes for _, batch in self._in_flight)
        if len(self._in_flight) < MAX_IN_FLIGHT and size < MAX_BYTES_IN_FLIGHT:
            for burst in sorted(self._bursts, key=lambda burst: burst.is_picking):
                sent = sum(len(batch.images) for of, batch in self._in_flight if of is burst)
                if burst.state is UploadState.SENDING and sent < len(burst.images):
                    return burst, burst.next_batch(sent)
        return None

    async def _report_burst(self, burst: Upload) -> tuple[Upload, Refusal] | None:
        """Report the burst to the leader, with its events the first time only; return any refusal.

        Drop images that the leader does not need or has already.
        """
        # Without those to be encoded, a burst that has ended would seem complete.
        report = burst.current_report((*burst.images, *(frame.instant for frame in burst.frames)))
        if burst.state is not UploadState.UNREPORTED:
            report = replace(report, events=())
        burst.take(UploadInput.REPORTED)
        answer = self._proven(await self.ask(report), burst)
        if isinstance(answer, Refusal):
            return burst, answer
        if answer.undecided:
            # The leader waits for other cameras. Questions about many bursts must not take all of the stream.
            delay_s = len(self._bursts) * ASK_AGAIN_S * 2 ** min(burst.attempts, MAX_DOUBLINGS)
            burst.put_off(asyncio.get_running_loop().time() + delay_s)
            return None
        stored = {receipt.instant: receipt.sha256 for receipt in answer.receipts}
        await _delete([*burst.commit(answer.requested, answer.end), *burst.confirm(stored)])
        if lost := burst.lost_instants():
            await self._report_lost(burst, lost, "the node was stopped before the frame was encoded")
        return None

    async def _send_images(self, burst: Upload, images: list[ImageUpload]) -> tuple[Upload, Refusal] | None:
        """Send images in one message; report what the spool has lost."""
        try:
            loaded = await asyncio.to_thread(burst.load, images)
        except DiskError as error:
            return burst, Refusal.of_error(error)
        if lost := [image.record.instant for image, of in zip(images, loaded, strict=True) if of is None]:
            await self._report_lost(burst, lost, "its file in the spool is damaged")
            return None
        batch = ImageBatch(images=tuple(images))
        self._in_flight.append((burst, batch))
        data = [of for of in loaded if of is not None]
        await self._channel.send(batch, *data, stall_s=UPLOAD_ANSWER_TIMEOUT_S)
        return None

    async def _take_answer(self) -> tuple[Upload, Refusal] | None:
        """Wait for the answer to the oldest unacknowledged batch, or for new work; return any refusal."""
        if self._answer is None:
            self._answer = asyncio.create_task(self._receive())
        changed = asyncio.create_task(self._changed.wait())
        try:
            await asyncio.wait({self._answer, changed}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            changed.cancel()
        return await self._take_next() if self._answer.done() else None

    async def _take_all_answers(self) -> tuple[Upload, Refusal] | None:
        """Wait for the answers to all sent images; return the first refusal."""
        refused = None
        while self._in_flight:
            answer = await self._take_next()
            refused = refused or answer
        return refused

    async def _take_next(self) -> tuple[Upload, Refusal] | None:
        answer, (burst, batch) = await self._next_answer(ImageAck), self._in_flight.popleft()
        answer = self._proven(answer, burst)
        if isinstance(answer, Refusal):
            if answer.error != DamagedImageError.__name__:
                return burst, answer
            await self._report_lost(burst, answer.damaged, answer.what)
            # The other images of a batch are sent again, after those that are on their way.
            return await self._take_all_answers()
        if answer.sha256 != batch.sha256:
            raise NetworkError("the leader has another checksum than the image sent")
        await _delete(burst.confirm({image.record.instant: image.sha256 for image in batch.images}))
        return None

    def _proven(self, answer: A | Refusal, burst: Upload) -> A | Refusal:
        """Return an answer, or a refusal for now where the leader above the relay has not signed it."""
        report, unsigned = burst.report, replace(answer, proof=None)
        about = report.camera, report.leader, report.burst
        if self.roots and not is_proven(answer.proof, self.roots, about, unsigned):
            return Refusal(
                what=f"the relay at {self._channel.peer} answered without the signature of its rig's leader",
                hint=f"if the rig has a new leader: capture-app trust pair {self._channel.peer}",
                retry=True,
            )
        return answer

    async def _next_answer(self, kind: type[A]) -> A | Refusal:
        task, self._answer = self._answer or asyncio.create_task(self._receive()), None
        answer = await task
        if not isinstance(answer, kind | Refusal):
            raise NetworkError("the leader sent an unexpected answer")
        return answer

    async def _receive(self) -> FromLeader:
        """Return the leader's next message, other than that it is still saving images."""
        waits = (
            f"images wait: no answer from {self._channel.peer} for {SAY_AFTER_S:.0f} s"
            " (check the network on both machines: capture-app doctor)"
        )
        while True:
            hint = LARGE_ARE_LOST if self._channel.has_spoken else ""
            saying = asyncio.get_running_loop().call_later(SAY_AFTER_S, self._log.say_once, waits)
            try:
                answer = await next_message(self._channel, UPLOAD_ANSWER_TIMEOUT_S, hint)
            finally:
                saying.cancel()
            if not isinstance(answer, ImageAck) or answer.sha256 is not None:
                return answer

    async def _report_lost(self, burst: Upload, instants: Collection[int], reason: str) -> None:
        files = burst.report_lost(instants, reason)
        self._log.say(
            f"burst {burst.report.burst}: instants {', '.join(map(str, instants))} are lost: {reason}"
        )
        await _write_report(burst, burst.report)
        await _delete(files)


async def _write_report(burst: Upload, report: CameraReport) -> None:
    """Store a burst's report where the spool has the burst, unless its disk fails."""
    if burst.spooled is not None:
        with contextlib.suppress(SimulshotError):
            await asyncio.to_thread(burst.spooled.write_report, report)


async def _delete(files: Collection[Path]) -> None:
    def delete() -> None:
        for file in files:
            # On a disk that is now read-only it stays, and is offered again when the node restarts.
            with contextlib.suppress(OSError):
                file.unlink(missing_ok=True)

    if files:
        await asyncio.to_thread(delete)


class Uploader:
    """Encoder of bursts into the spool, and their sender in order, over a stream that it reopens."""

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
        """Upload for a camera as this run of its node, to leaders known by `trust`.

        `retry_s` are the delays after the first failed stream, the second and so on; the last one repeats.
        """
        self._log, self._trust = log, trust or Trust.of_user()
        self._opening = NodeStream(camera=camera, instance=instance)
        self.spool, self._retry_s = spool, retry_s
        self.leader: Address | None = None
        self._run: int | None = None
        self._bursts: list[Upload] = []
        """All bursts that this node keeps, those that a leader refused among them."""
        self._changed = asyncio.Event()
        self._to_encode = asyncio.Event()
        self._to_sync = asyncio.Event()
        self._space_is_due = False
        self._thread = ThreadPoolExecutor(1, "encode")
        self._encoding: asyncio.Task[None] | None = None
        self._stream: Channel[Any] | None = None
        self._roots: Collection[str] = ()
        self.problem = ""
        """Why no stream reaches the leader, while several attempts in a row have failed; else empty."""

    @property
    def is_busy(self) -> bool:
        """Whether images are being encoded or sent, as opposed to waiting for the leader or work."""
        return self._stream is not None or any(burst.frames for burst in self._bursts)

    @property
    def _has_work(self) -> bool:
        """Whether the leader is to hear of a burst, or of the spool."""
        return self._space_is_due or any(burst.state is not UploadState.REFUSED for burst in self._bursts)

    def load_spool(self) -> None:
        """Add the bursts that an earlier run of this node left in the spool. Blocks on the disk.

        Raises SimulshotError.
        """
        if self.spool is not None:
            self._bursts.extend(self._read(self.spool.open()))
            if unknown := [*map(str, unknown_in(self.spool.folder))]:
                names = [*unknown[:MAX_NAMED], *(["..."] if len(unknown) > MAX_NAMED else [])]
                self._log.say(f"not understood by this version, and left alone: {', '.join(names)}")

    def _read(self, left: Iterable[SpoolFolder]) -> list[Upload]:
        """Return the bursts in these folders of the spool with images; delete others. Blocks on the disk."""
        bursts = []
        for spooled in left:
            try:
                burst = Upload.of_spool(spooled)
            except SimulshotError as error:
                self._log.say(f"left in the spool: {error}")
                continue
            if burst.images:
                images = count(len(burst.images), "image")
                self._log.say(f"burst {burst.report.burst}: {images} still in {spooled.folder}")
                # A run that was killed may have written them without waiting for the disk.
                burst.unsynced.update(burst.images)
                bursts.append(burst)
            else:
                spooled.remove()
        return bursts

    def add_burst(self, burst: Upload) -> None:
        """Add a burst; the oldest one is given up when too many wait for a lost leader.

        Of what an earlier run of the node began, a streamed burst goes on; another one stays as it was.
        """
        for left in self._uploads_of(burst.report.leader, burst.report.burst):
            if left.ended and not left.streamed:
                if not burst.streamed:
                    return
                if left.state is not UploadState.OVER:
                    burst.continue_from(left)
                self._bursts.remove(left)
        self._bursts.append(burst)
        if len(self._bursts) > MAX_WAITING_BURSTS:
            given_up = self._bursts.pop(0)
            where = f"; its images are in {given_up.spooled.folder}" if given_up.spooled else ""
            self._log.say(f"burst {given_up.report.burst} given up: the leader was lost for too long{where}")
        self._changed.set()
        self._to_encode.set()

    def extend_burst(self, picked: FramesSelected[CapturedFrame]) -> None:
        """Add further instants to an earlier burst, if they are still needed."""
        for upload in self._uploads_of(picked.trigger.leader, picked.trigger.burst):
            upload.extend(picked)
            if not upload.is_picking:
                self._changed.set()
        self._to_encode.set()

    def widen_times(self, times: WidenedTimes) -> None:
        """Report to the leader that a clock was wrong, for every burst that is not finished."""
        for upload in self._bursts:
            upload.widen_times(times)
        self._changed.set()

    def note_move(self, move: PhaseMove) -> None:
        """Report to the leader that a stream was moved, for every recording that is under way."""
        for upload in filter(lambda of: of.is_picking, self._bursts):
            camera = upload.report.plan.camera
            upload.change_report(camera=replace(camera, moves=(*camera.moves, move)[:MAX_MOVES]))
        self._changed.set()

    def cancel_burst(self, leader: int, burst: int) -> None:
        """Drop a burst that its leader has cancelled; below a relay, once that leader has signed it."""
        for upload in self._uploads_of(leader, burst):
            (upload.stop_selecting if self._roots else upload.end)()
            self._log.say(f"burst {burst} was cancelled")
        self._changed.set()

    async def run(self) -> None:
        """Encode frames and send images to the leader, until cancelled."""
        async with asyncio.TaskGroup() as tasks:
            for work in (self._encode_all(), self._send_all(), self._sync_spool(), self._offer_again()):
                tasks.create_task(work)

    async def aclose(self) -> None:
        """Move the frames that are in memory to the spool, where the next run of this node finds them.

        The camera may be closed before; simulated frames that are not rendered yet may take minutes.
        """
        try:
            if self._encoding is not None:
                await self._encoding
            left = [burst for burst in self._bursts if burst.frames and burst.spooling]
            if self.spool is not None and left:
                frames = count(sum(len(burst.frames) for burst in left), "frame")
                self._log.say(f"{frames} are saved in {self.spool.folder} before this node ends")
                for burst in left:
                    while burst.frames and burst.spooling:
                        await self._encode_next(burst)
            # Also where the last frame was being encoded, and none is left.
            await self._store_ends()
        finally:
            self._thread.shutdown(wait=False, cancel_futures=True)

    def set_leader(self, leader: Address, run: int | None = None) -> None:
        """Send images to that address from now on, and offer refused bursts again.

        `run` is the leader's run. A leader can order the deletion of bursts of its own run only.
        """
        if leader != self.leader and self._stream is not None:
            # The stream to a relay that lost power might never be closed otherwise.
            self._stream.abort()
        self.leader, self._run = leader, run
        self._reopen_refused()
        self._space_is_due = True

    def _reopen_refused(self) -> None:
        for burst in self._bursts:
            if burst.state is UploadState.REFUSED:
                burst.reopen()
        self._changed.set()

    async def _offer_again(self) -> None:
        while True:
            await asyncio.sleep(OFFER_AGAIN_S)
            self._reopen_refused()

    async def _encode_all(self) -> None:
        """Encode pending frames, and move each to its burst's images.

        Streamed bursts take turns; of the others, those of the first are encoded before those of the next.
        """
        while True:
            self._to_encode.clear()
            await self._store_ends()
            waiting = [burst for burst in self._bursts if burst.frames]
            still = [burst for burst in waiting if not burst.streamed][:1]
            for burst in (*(burst for burst in waiting if burst.streamed), *still):
                # The thread cannot be cancelled: what it has begun is completed by `aclose`.
                self._encoding = asyncio.create_task(self._encode_next(burst))
                await asyncio.shield(self._encoding)
            if not waiting:
                await self._to_encode.wait()
            elif not still:
                await asyncio.sleep(ENCODE_EVERY_S)

    async def _encode_next(self, burst: Upload) -> None:
        """Encode the next frame of a burst, or frames of a streamed one, and add them to its images."""
        picks = tuple(islice(burst.frames, MAX_BATCH_IMAGES if burst.streamed else 1))
        results = await asyncio.get_running_loop().run_in_executor(self._thread, self._encode, burst, picks)
        for picked, result in zip(picks, results, strict=True):
            if isinstance(result, CameraError):
                burst.report_lost([picked.instant], str(result))
                self._log.say(f"burst {burst.report.burst}: instant {picked.instant} is lost: {result}")
            # The leader may have refused the burst while the frame was encoded.
            if burst.frames and burst.frames[0] is picked:
                burst.frames.popleft()
                if not isinstance(result, CameraError):
                    burst.images[picked.instant] = result
        if burst.state is UploadState.OVER:
            await self._remove_spooled(burst)
        self._changed.set()
        self._to_sync.set()

    def _encode(
        self, burst: Upload, picks: Sequence[SelectedFrame[CapturedFrame]]
    ) -> list[ImageUpload | CameraError]:
        """Encode frames into the spool if there is room, else into memory; runs in a thread of its own."""
        results: list[ImageUpload | CameraError] = []
        images: list[tuple[ImageUpload, bytes]] = []
        for picked in picks:
            try:
                images.append(encode_frame(burst.report, picked, with_truth=burst.with_truth))
                results.append(images[-1][0])
            except CameraError as error:
                results.append(error)
        in_memory = {image.record.instant: data for image, data in images}
        is_spooled = self.spool is not None and burst.spooling and bool(images)
        try:
            if is_spooled and self.spool is not None:
                if burst.spooled is None:
                    burst.spooled = self.spool.create_burst(burst.current_report())
                burst.spooled.add(images)
        except SimulshotError as error:
            is_spooled = False
            self._note_useless_spool(burst, error)
        if is_spooled:
            burst.unsynced.update({image.record.instant: image for image, _ in images})
        if not (is_spooled and burst.streamed):
            # Until a burst is synced its images are in memory, too: a disk may fail between the two.
            burst.in_memory.update(in_memory)
        return results

    def _note_useless_spool(self, burst: Upload, error: SimulshotError) -> None:
        """Keep a burst in memory from now on, as the spool failed; the next burst tries the spool again."""
        burst.spooling, self._space_is_due = False, True
        self._log.say(f"burst {burst.report.burst} stays in memory until the leader has it: {error}")

    async def _store_ends(self) -> None:
        """Store the final reports of ended bursts in the spool."""
        for burst in [*self._bursts]:
            if burst.streamed and burst.ended and not (burst.frames or burst.end_is_stored):
                burst.end_is_stored = True
                await _write_report(burst, burst.current_report())

    async def _sync_spool(self) -> None:
        """Sync the spool for all images that were written during the previous sync."""
        now = asyncio.get_running_loop().time
        while True:
            await has_come(
                self._to_sync, UNSYNCED_S if any(upload.unsynced for upload in self._bursts) else None
            )
            self._to_sync.clear()
            for burst in [*self._bursts]:
                images, spooled = dict(burst.unsynced), burst.spooled
                if not images or spooled is None:
                    continue
                if burst.oldest[0] != (oldest := next(iter(images))):
                    burst.oldest = oldest, now()
                try:
                    # Streamed images that the leader has soon are here too briefly to be worth a sync.
                    is_due = self._stream is None or now() - burst.oldest[1] >= UNSYNCED_S
                    if is_due or not burst.streamed:
                        await asyncio.to_thread(spooled.sync)
                        for instant in images:
                            burst.unsynced.pop(instant, None)
                except SimulshotError as error:
                    burst.unsynced.clear()
                    self._note_useless_spool(burst, error)
                else:
                    for instant in images:
                        burst.in_memory.pop(instant, None)

    async def _send_all(self) -> None:
        failures = 0
        while True:
            while self.leader is None or not self._has_work:
                self._changed.clear()
                is_idle = not await has_come(self._changed, SPACE_EVERY_S)
                self._space_is_due |= is_idle and self.spool is not None
            try:
                async with (
                    await connect(self.leader, FromLeader, trust=self._trust) as channel,
                    contextlib.aclosing(
                        Sender(
                            channel,
                            self._changed,
                            self._log,
                            self._bursts,
                            self._trust.roots_of(channel.who.pin),
                        )
                    ) as sender,
                ):
                    self._stream, self._roots = channel, sender.roots
                    if isinstance(refusal := await sender.ask(self._opening), Refusal):
                        raise NetworkError(refusal.what, hint=refusal.hint)
                    self.problem = ""
                    while self._has_work:
                        if self._space_is_due:
                            self._space_is_due = False
                            if self.spool is not None:
                                # Two uploads of one burst would write into one folder.
                                under_way = {folder_name(burst.report) for burst in self._bursts}
                                adopted = await asyncio.to_thread(self.spool.adopt, under_way)
                                self._bursts.extend(await asyncio.to_thread(self._read, adopted))
                                self._to_sync.set()
                                await sender.ask(await asyncio.to_thread(self.spool.look))
                        else:
                            await self._conclude(*await sender.next_ended())
                        failures = 0
            except NetworkError as error:
                if failures:
                    self.problem = f"its images wait: {error}"
                else:
                    self._log.say(f"images wait: {error}")
                await asyncio.sleep(self._retry_s[min(failures, len(self._retry_s) - 1)])
                failures += 1
            finally:
                self._stream = None

    async def _conclude(self, burst: Upload, refusal: Refusal | None) -> None:
        """Delete a burst that is over, or keep what its leader's `refusal` does not let this node delete."""
        where = ""
        if refusal is None or (refusal.forget and burst.report.leader == self._run):
            burst.end()
            await self._remove_spooled(burst)
            self._space_is_due = True
        else:
            # A burst that is not this leader's to delete is kept whole: its last frames, too.
            while burst.frames and burst.spooling and self.spool is not None:
                self._changed.clear()
                await self._changed.wait()
            burst.frames.clear()
            burst.take(UploadInput.REFUSED)
            if burst.spooled is not None and burst.spooled.folder.exists():
                where = f"; its images stay in {burst.spooled.folder}: delete that folder to drop them"
        if refusal is not None:
            self._log.say_once(f"burst {burst.report.burst} given up: {refusal.as_error()}{where}")
        if not where and burst in self._bursts:
            self._bursts.remove(burst)

    async def _remove_spooled(self, burst: Upload) -> None:
        if self.spool is not None and burst.spooled is not None:
            await asyncio.to_thread(self.spool.remove, burst.spooled)

    def _uploads_of(self, leader: int, burst: int) -> list[Upload]:
        return [
            upload
            for upload in self._bursts
            if upload.report.leader == leader and upload.report.burst == burst
        ]
