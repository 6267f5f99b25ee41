"""Brings a node's images to the leader and keeps each until the leader has it safely on disk."""

import asyncio
import contextlib
from collections import deque
from collections.abc import Callable
from typing import Any

import msgspec

from capture_app.errors import NetworkError, SimulshotError
from capture_app.net.address import Address
from capture_app.net.transfer import Channel, connect
from capture_app.node.transfer.encoding import Developer, without
from capture_app.node.transfer.spool import Spool
from capture_app.node.transfer.work import BurstWork, Developed
from capture_app.node.wire.disk_space import free_bytes, guessed_image_bytes
from capture_app.node.wire.messages import (
    CameraReport,
    FromLeader,
    Held,
    ImageUpload,
    NodeSpace,
    Noted,
    Refusal,
    Stored,
)
from capture_app.session.format.manifest import CameraRecord, MissingImage

RETRY_S = (0.5, 1.0, 2.0, 4.0)
ANSWER_TIMEOUT_S = 30.0
SPACE_EVERY_S = 30.0
MAX_WAITING_BURSTS = 64
LOW_PRIORITY = 10
"""Niceness of the thread that develops pictures: the clock exchange comes first."""

Talk = Callable[[str], None]


class _LaterError(NetworkError):
    """The leader cannot take a burst now."""


class Uploader:
    """Develops bursts into the spool, and sends them in their order over a stream that it reopens."""

    def __init__(self, talk: Talk, spool: Spool | None = None) -> None:
        self.talk = talk
        self.spool = spool
        self.leader: Address | None = None
        self._waiting: deque[BurstWork] = deque()
        self._refused: deque[BurstWork] = deque(maxlen=MAX_WAITING_BURSTS)
        self._news = asyncio.Event()
        self._exposed = asyncio.Event()
        self._camera: CameraRecord | None = None
        self._space_is_due = False
        self._developer = Developer(talk, spool)
        self._stream: Channel[Any] | None = None

    def load_spool(self) -> None:
        """Take on what an earlier run of this node has left in the spool. Raises SimulshotError."""
        for burst in self.spool.open() if self.spool is not None else ():
            try:
                report, uploads = burst.report(), list(burst.images())
            except SimulshotError as error:
                self.talk(f"left in the spool: {error}")
                continue
            if not uploads:
                burst.remove()
                continue
            self.talk(f"burst {report.burst}: {len(uploads)} images are still in {burst.folder}")
            images = deque(Developed(upload, None) for upload in uploads)
            self._waiting.append(BurstWork(report, deque(), images, spooled=burst))

    def add(self, work: BurstWork) -> None:
        """Take on a burst; the oldest is given up where a leader has been away for too many."""
        self._waiting.append(work)
        self._camera = work.report.camera
        if len(self._waiting) > MAX_WAITING_BURSTS:
            given_up = self._waiting.popleft()
            where = f"; what it has is in {given_up.spooled.folder}" if given_up.spooled else ""
            self.talk(f"burst {given_up.report.burst} given up: the leader is away for too long{where}")
        self._news.set()
        self._exposed.set()

    async def run(self) -> None:
        """Develop and send for ever."""
        try:
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self._develop_all())
                tasks.create_task(self._send_all())
                tasks.create_task(self._watch_space())
        finally:
            self._developer.close()

    def close(self) -> None:
        """Let another node use the spool."""
        if self.spool is not None:
            self.spool.close()

    def leader_found(self, leader: Address, camera: CameraRecord | None = None) -> None:
        """Images go to that address from now on; what was refused before is offered again."""
        if leader != self.leader and self._stream is not None:
            # Nobody may ever close the stream to a relay whose plug was pulled.
            self._stream.abort()
        self.leader = leader
        self._camera = camera or self._camera
        self._waiting.extendleft(reversed(self._refused))
        self._refused.clear()
        self._space_is_due = True
        self._news.set()

    # Developing

    async def _develop_all(self) -> None:
        while True:
            self._exposed.clear()
            work = next((work for work in self._waiting if work.picks), None)
            if work is None:
                await self._exposed.wait()
                continue
            await self._developer.develop_next(work)
            self._news.set()

    # Sending

    async def _send_all(self) -> None:
        failures = 0
        while True:
            while self.leader is None or not (self._waiting or self._space_is_due):
                self._news.clear()
                await self._news.wait()
            try:
                async with await connect(self.leader, FromLeader) as channel:
                    self._stream = channel
                    while self._waiting or self._space_is_due:
                        if self._space_is_due:
                            await self._tell_space(channel)
                            continue
                        work = self._waiting[0]
                        await self._send_burst(channel, work)
                        with contextlib.suppress(ValueError):
                            self._waiting.remove(work)
                        failures = 0
            except NetworkError as error:
                if isinstance(error, _LaterError):
                    self._waiting.rotate(-1)
                if not failures:
                    self.talk(f"images wait: {error}")
                await asyncio.sleep(RETRY_S[min(failures, len(RETRY_S) - 1)])
                failures += 1
            finally:
                self._stream = None

    async def _send_burst(self, channel: Channel[Any], work: BurstWork) -> None:
        # A leader that was away has kept what it acknowledged; only the stream's own state is new.
        told: CameraReport | None = None
        held: dict[int, Held] = {}
        while True:
            self._news.clear()
            if told is not work.report:
                told = work.report
                answer = await self._ask(channel, told)
                if isinstance(answer, Refusal):
                    return self._put_away(work, answer)
                held = {part.instant: part for part in answer.held}
                await self._tell_lost(work, held)
            elif work.images:
                if refusal := await self._send_image(channel, work, work.images[0], held):
                    return self._put_away(work, refusal)
            elif work.picks:
                await self._news.wait()
            else:
                break
        if work.spooled is not None:
            await asyncio.to_thread(work.spooled.remove)
        self._space_is_due = self.spool is not None
        return None

    async def _send_image(
        self, channel: Channel[Any], work: BurstWork, image: Developed, held: dict[int, Held]
    ) -> Refusal | None:
        record = image.upload.record
        part = held.pop(record.instant, None)
        if part is None or not part.stored:
            data = await asyncio.to_thread(work.load, image)
            if data is None:
                work.images.popleft()
                await self._lose(work, "its file in the spool is damaged", record.instant)
                return None
            resumes = part is not None and part.sha256 == record.sha256 and part.bytes <= len(data)
            offset = part.bytes if part is not None and resumes else 0
            upload = msgspec.structs.replace(image.upload, offset=offset)
            answer = await self._ask(channel, upload, memoryview(data)[offset:])
            if isinstance(answer, Refusal):
                return answer
        work.images.popleft()
        work.confirmed.add(record.instant)
        if work.spooled is not None:
            await asyncio.to_thread(work.spooled.confirmed, image.upload)
        return None

    async def _tell_lost(self, work: BurstWork, held: dict[int, Held]) -> None:
        """What was announced and is neither here nor there was lost when this node was stopped."""
        here = {image.upload.record.instant for image in work.images} | {pick.instant for pick in work.picks}
        work.confirmed |= {part.instant for part in held.values() if part.stored}
        lost = sorted(set(work.report.instants) - here - work.confirmed)
        if lost:
            await self._lose(work, "the node was stopped before the frame was developed", *lost)

    async def _lose(self, work: BurstWork, reason: str, *instants: int) -> None:
        name = work.report.camera.name
        gone = (MissingImage(camera=name, instant=instant, reason=reason) for instant in instants)
        work.report = without(work.report, *gone)
        numbers = ", ".join(map(str, instants))
        self.talk(f"burst {work.report.burst}: instants {numbers} are lost: {reason}")
        if work.spooled is not None:
            with contextlib.suppress(SimulshotError):
                await asyncio.to_thread(work.spooled.set_report, work.report)

    def _put_away(self, work: BurstWork, refusal: Refusal) -> None:
        if refusal.retry:
            raise _LaterError(f"{refusal.what} ({refusal.hint})" if refusal.hint else refusal.what)
        work.picks.clear()
        if work.spooled is not None:
            self._refused.append(work)
            kept = f"; its images stay in {work.spooled.folder}"
        else:
            kept = ""
        self.talk(f"burst {work.report.burst} given up: {refusal.what}{kept}")

    async def _ask(
        self, channel: Channel[Any], message: CameraReport | ImageUpload | NodeSpace, *payloads: memoryview
    ) -> Noted | Refusal:
        """Send a part of a burst and wait until the leader has it; a Stored counts as noted."""
        try:
            async with asyncio.timeout(ANSWER_TIMEOUT_S):
                await channel.send(message, *payloads)
                received = await channel.receive()
        except TimeoutError as error:
            raise NetworkError(f"the leader did not take an image within {ANSWER_TIMEOUT_S:g} s") from error
        match received:
            case None:
                raise NetworkError("the leader closed the stream")
            case (Noted() as noted, _) if not isinstance(message, ImageUpload):
                return noted
            case (Stored(sha256=sha256), _) if isinstance(message, ImageUpload):
                if sha256 != message.record.sha256:
                    raise NetworkError("the leader stored other bytes than were sent")
                return Noted()
            case (Refusal() as refusal, _):
                return refusal
        raise NetworkError("the leader answered something else than was asked")

    # Room

    async def _watch_space(self) -> None:
        while self.spool is not None:
            await asyncio.sleep(SPACE_EVERY_S)
            self._space_is_due = True
            self._news.set()

    async def _tell_space(self, channel: Channel[Any]) -> None:
        self._space_is_due = False
        if self.spool is None or self._camera is None:
            return
        facts = self._camera.facts
        size = self._developer.image_bytes or guessed_image_bytes(facts.width, facts.height)
        space = NodeSpace(
            camera=self._camera.name,
            free_bytes=free_bytes(self.spool.folder),
            image_bytes=size,
            spool=str(self.spool.folder),
        )
        await self._ask(channel, space)
