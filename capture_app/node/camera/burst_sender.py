"""A burst over one open stream to the leader: its report, then each image until the leader has it on disk."""

import asyncio
import contextlib
from collections import deque
from collections.abc import Collection
from pathlib import Path
from typing import Any

from msgspec.structs import replace

from capture_app.errors import DiskError, NetworkError, SimulshotError
from capture_app.net.channel import Channel
from capture_app.node.camera.burst_upload import BurstUpload
from capture_app.node.news import Log
from capture_app.node.wire import messages

ANSWER_TIMEOUT_S = 30.0
MAX_IN_FLIGHT = 64
"""How many images are sent ahead of the leader's answers: its disk is synced for many at a time."""
ASK_AGAIN_S = 0.05

Answer = messages.ImageAck | messages.ReportAck | messages.Refusal


class PostponedError(NetworkError):
    """The leader cannot take a burst now, and may later."""


class BurstSender:
    """Sends bursts over one stream; `news` is set whenever there is more to send."""

    def __init__(
        self, channel: Channel[Any], news: asyncio.Event, log: Log, waiting: Collection[BurstUpload]
    ) -> None:
        """`waiting` are all bursts that are to be sent, over one such stream after the other."""
        self._channel, self._news, self._log, self._waiting = channel, news, log, waiting
        self._in_flight: deque[messages.ImageUpload] = deque()
        self._answer: asyncio.Task[Answer] | None = None
        self._receipts: dict[int, messages.ImageReceipt] = {}
        """By instant, what the leader has of images of which the rest is to be sent."""

    async def aclose(self) -> None:
        """Wait for no answer any more."""
        if self._answer is not None:
            self._answer.cancel()
            await asyncio.gather(self._answer, return_exceptions=True)

    async def ask(
        self,
        message: messages.NodeStream | messages.CameraReport | messages.SpoolSpace,
    ) -> messages.ReportAck | messages.Refusal:
        """Send a message and wait until the leader has what it tells.

        Raises NetworkError where the stream breaks off or the leader does not answer.
        """
        await self._send(message)
        answer = await self._next_answer()
        if isinstance(answer, messages.ImageAck):
            raise NetworkError("the leader sent an unexpected answer")
        return answer

    async def send_burst(self, burst: BurstUpload) -> messages.Refusal | None:
        """Send a burst as it is encoded; returns when the leader has all it wants, or its refusal for good.

        Returns, too, where one that is still being picked has nothing to send at present, and another has.
        Raises PostponedError where the leader may want it later, NetworkError where the stream breaks off.
        """
        # A leader that was away has kept what it acknowledged; only the stream's own state is new.
        told: messages.CameraReport | None = None
        burst.reopen()
        while not burst.is_over:
            self._news.clear()
            refusal = None
            if told is not burst.report or not burst.is_committed:
                first, told = told is None, burst.report
                refusal = await self._tell(burst, first=first)
            elif len(burst.images) > len(self._in_flight) < MAX_IN_FLIGHT:
                await self._send_image(burst, burst.images[len(self._in_flight)])
            elif self._in_flight:
                refusal = await self._take_answer(burst)
            elif (
                burst.is_picking
                and not burst.frames
                and any(other.has_work for other in self._waiting if other is not burst)
            ):
                return None
            elif burst.frames or burst.is_picking:
                await self._news.wait()
            elif burst.disputed:
                numbers = ", ".join(str(image.record.instant) for image in burst.disputed)
                return messages.Refusal(
                    what=f"the leader has other pictures than these of instants {numbers}"
                )
            else:
                return None
            if refusal is not None:
                await self._take_all_answers(burst)
                if refusal.retry:
                    raise PostponedError(refusal.what, hint=refusal.hint)
                return refusal
        await self._take_all_answers(burst)
        return None

    async def _tell(self, burst: BurstUpload, *, first: bool) -> messages.Refusal | None:
        """Tell what the node has of the burst, its events only at first.

        Let go of what the leader does not want or has already, and note what it has of the rest.
        """
        refusal = await self._take_all_answers(burst)
        if refusal is not None:
            return refusal
        report = burst.report_now()
        answer = await self.ask(report if first else replace(report, events=()))
        if isinstance(answer, messages.Refusal):
            return answer
        self._receipts = {receipt.instant: receipt for receipt in answer.receipts if not receipt.stored}
        if answer.undecided:
            # The leader takes its time before it says so; another one may not.
            await asyncio.sleep(ASK_AGAIN_S)
            return None
        unwanted = burst.commit(answer.wanted)
        stored = {receipt.instant: receipt.sha256 for receipt in answer.receipts if receipt.stored}
        await _delete([*unwanted, *burst.confirm(stored)])
        if lost := burst.lost_instants():
            await self._report_lost(burst, lost, "the node was stopped before the frame was encoded")
        return None

    async def _send_image(self, burst: BurstUpload, image: messages.ImageUpload) -> None:
        record = image.record
        try:
            data = await asyncio.to_thread(burst.load, image)
        except DiskError as error:
            raise PostponedError(error.what, hint=error.hint) from error
        if data is None:
            with contextlib.suppress(ValueError):
                burst.images.remove(image)
            await self._report_lost(burst, [record.instant], "its file in the spool is damaged")
            return
        receipt = self._receipts.pop(record.instant, None)
        resumes = receipt is not None and receipt.sha256 == record.sha256 and receipt.bytes <= len(data)
        offset = receipt.bytes if receipt is not None and resumes else 0
        self._in_flight.append(image)
        await self._send(replace(image, offset=offset), memoryview(data)[offset:])

    async def _take_answer(self, burst: BurstUpload) -> messages.Refusal | None:
        """Wait for the answer to the image that was sent first, or for news of the burst."""
        if self._answer is None:
            self._answer = asyncio.create_task(self._receive())
        news = asyncio.create_task(self._news.wait())
        try:
            await asyncio.wait({self._answer, news}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            news.cancel()
        return await self._take_next(burst) if self._answer.done() else None

    async def _take_all_answers(self, burst: BurstUpload) -> messages.Refusal | None:
        """Wait for the answers to all images that were sent; return the first refusal."""
        refusal = None
        while self._in_flight:
            refused = await self._take_next(burst)
            refusal = refusal or refused
        return refusal

    async def _take_next(self, burst: BurstUpload) -> messages.Refusal | None:
        answer, image = await self._next_answer(), self._in_flight.popleft()
        if isinstance(answer, messages.Refusal):
            return answer
        if not isinstance(answer, messages.ImageAck):
            raise NetworkError("the leader sent an unexpected answer")
        if answer.sha256 != image.record.sha256:
            raise NetworkError("the leader has another checksum than the image sent")
        await _delete(burst.confirm({image.record.instant: answer.sha256}))
        return None

    async def _next_answer(self) -> Answer:
        answer, self._answer = self._answer or asyncio.create_task(self._receive()), None
        return await answer

    async def _send(
        self,
        message: messages.NodeStream | messages.CameraReport | messages.ImageUpload | messages.SpoolSpace,
        *payloads: memoryview,
    ) -> None:
        await self._channel.send(message, *payloads, stall_s=ANSWER_TIMEOUT_S)

    async def _receive(self) -> Answer:
        while True:
            try:
                async with asyncio.timeout(ANSWER_TIMEOUT_S):
                    received = await self._channel.receive()
            except TimeoutError as error:
                raise NetworkError(f"the leader did not answer within {ANSWER_TIMEOUT_S:g} s") from error
            match received:
                case None:
                    raise NetworkError("the leader closed the stream")
                case (messages.ImageAck(sha256=None), _):
                    continue
                case (messages.ReportAck() | messages.ImageAck() | messages.Refusal() as answer, _):
                    return answer
            raise NetworkError("the leader sent an unexpected answer")

    async def _report_lost(self, burst: BurstUpload, instants: Collection[int], reason: str) -> None:
        burst.report_lost(instants, reason)
        numbers = ", ".join(map(str, instants))
        self._log.say(f"burst {burst.report.burst}: instants {numbers} are lost: {reason}")
        if burst.spooled is not None:
            with contextlib.suppress(SimulshotError):
                await asyncio.to_thread(burst.spooled.write_report, burst.report)


async def _delete(files: Collection[Path]) -> None:
    def delete() -> None:
        for file in files:
            # On a disk that is read-only now it stays, and is offered again when the node is started again.
            with contextlib.suppress(OSError):
                file.unlink(missing_ok=True)

    if files:
        await asyncio.to_thread(delete)
