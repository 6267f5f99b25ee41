"""A burst over one open stream to the leader: its report, then each image until the leader has it on disk."""

import asyncio
import contextlib
from collections.abc import Callable, Collection
from typing import Any

from msgspec.structs import replace

from capture_app.errors import NetworkError, SimulshotError
from capture_app.net.channel import Channel
from capture_app.node.transfer.burst_upload import BurstUpload
from capture_app.node.wire import messages

ANSWER_TIMEOUT_S = 30.0


class PostponedError(NetworkError):
    """The leader cannot take a burst now, and may later."""


class BurstSender:
    """Sends bursts over one stream; `news` is set whenever an image was encoded."""

    def __init__(self, channel: Channel[Any], news: asyncio.Event, talk: Callable[[str], None]) -> None:
        self._channel = channel
        self._news = news
        self._talk = talk

    async def send_burst(self, burst: BurstUpload) -> messages.Refusal | None:
        """Send a burst as it is encoded; returns when the leader has it all, or its refusal for good.

        Raises PostponedError where the leader may want it later, NetworkError where the stream breaks off.
        """
        # A leader that was away has kept what it acknowledged; only the stream's own state is new.
        told: messages.CameraReport | None = None
        receipts: dict[int, messages.ImageReceipt] = {}
        while True:
            self._news.clear()
            if told is not burst.report:
                told = burst.report
                answer = await self.ask(told)
                if isinstance(answer, messages.Refusal):
                    return _final(answer)
                receipts = {receipt.instant: receipt for receipt in answer.receipts}
                burst.confirmed |= {instant for instant, receipt in receipts.items() if receipt.stored}
                if lost := burst.lost_instants():
                    await self._report_lost(burst, lost, "the node was stopped before the frame was encoded")
            elif burst.images:
                refusal = await self._send_image(burst, burst.images[0], receipts)
                if refusal is not None:
                    return _final(refusal)
            elif burst.frames:
                await self._news.wait()
            else:
                return None

    async def ask(
        self,
        message: messages.CameraReport | messages.ImageUpload | messages.SpoolSpace,
        *payloads: memoryview,
    ) -> messages.ReportAck | messages.Refusal:
        """Send a message and wait until the leader has what it tells; an ImageAck counts as a ReportAck.

        Raises NetworkError where the stream breaks off or the leader does not answer.
        """
        try:
            async with asyncio.timeout(ANSWER_TIMEOUT_S):
                await self._channel.send(message, *payloads)
                received = await self._channel.receive()
        except TimeoutError as error:
            raise NetworkError(
                f"the leader did not acknowledge an image within {ANSWER_TIMEOUT_S:g} s"
            ) from error
        match received:
            case None:
                raise NetworkError("the leader closed the stream")
            case (messages.ReportAck() as noted, _) if not isinstance(message, messages.ImageUpload):
                return noted
            case (messages.ImageAck(sha256=sha256), _) if isinstance(message, messages.ImageUpload):
                if sha256 != message.record.sha256:
                    raise NetworkError("the leader has another checksum than the image sent")
                return messages.ReportAck()
            case (messages.Refusal() as refusal, _):
                return refusal
        raise NetworkError("the leader sent an unexpected answer")

    async def _send_image(
        self, burst: BurstUpload, image: messages.ImageUpload, receipts: dict[int, messages.ImageReceipt]
    ) -> messages.Refusal | None:
        record = image.record
        receipt = receipts.pop(record.instant, None)
        if receipt is None or not receipt.stored:
            data = await asyncio.to_thread(burst.load, image)
            if data is None:
                burst.images.popleft()
                await self._report_lost(burst, [record.instant], "its file in the spool is damaged")
                return None
            resumes = receipt is not None and receipt.sha256 == record.sha256 and receipt.bytes <= len(data)
            offset = receipt.bytes if receipt is not None and resumes else 0
            answer = await self.ask(replace(image, offset=offset), memoryview(data)[offset:])
            if isinstance(answer, messages.Refusal):
                return answer
        burst.images.popleft()
        await asyncio.to_thread(burst.confirm, image)
        return None

    async def _report_lost(self, burst: BurstUpload, instants: Collection[int], reason: str) -> None:
        burst.report_lost(instants, reason)
        numbers = ", ".join(map(str, instants))
        self._talk(f"burst {burst.report.burst}: instants {numbers} are lost: {reason}")
        if burst.spooled is not None:
            with contextlib.suppress(SimulshotError):
                await asyncio.to_thread(burst.spooled.write_report, burst.report)


def _final(refusal: messages.Refusal) -> messages.Refusal:
    """The refusal, if it is for good. Raises PostponedError if it is not."""
    if refusal.retry:
        raise PostponedError(refusal.what, hint=refusal.hint)
    return refusal
