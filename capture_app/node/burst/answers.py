"""What a leader answers to nodes that bring images."""

import asyncio
import contextlib
from typing import Any

from capture_app.errors import (
    BadInputError,
    DiskError,
    NetworkError,
    SimulshotError,
    TryAgainError,
    UnknownMachineError,
)
from capture_app.net.channel import Channel
from capture_app.node.wire.messages import ImageAck, Refusal

STILL_SAVING_EVERY_S = 5.0


class CancelledBurstError(BadInputError):
    """A node brings images of a burst that was cancelled: it may delete them."""


def refusal_of(error: SimulshotError) -> Refusal:
    """Tell an error, and whether what it is about may be asked for again, or be forgotten."""
    retry = isinstance(error, DiskError | TryAgainError | UnknownMachineError)
    return Refusal.of_error(error, retry=retry, forget=isinstance(error, CancelledBurstError))


class ImageAnswers:
    """Answers to the images of one stream, in their order, while further ones come in."""

    def __init__(self, channel: Channel[Any]) -> None:
        self._channel = channel
        self._waiting: asyncio.Queue[asyncio.Future[str]] = asyncio.Queue()
        self._telling: asyncio.Task[None] | None = None

    def add(self, saving: "asyncio.Future[str]") -> None:
        """Answer with an image's checksum once it is known, or with what went wrong."""
        self._waiting.put_nowait(saving)
        if self._telling is None:
            self._telling = asyncio.create_task(self._tell_all())

    async def drain(self) -> None:
        """Wait until all has been answered."""
        await self._waiting.join()

    async def close(self) -> None:
        """Answer no more; images that have come are saved all the same."""
        if self._telling is not None:
            self._telling.cancel()
            await asyncio.gather(self._telling, return_exceptions=True)

    async def _tell_all(self) -> None:
        while True:
            saving = await self._waiting.get()
            # A stream that has broken off is noticed by whoever reads it.
            with contextlib.suppress(NetworkError):
                while not (await asyncio.wait({saving}, timeout=STILL_SAVING_EVERY_S))[0]:
                    await self._channel.send(ImageAck())
                if not saving.cancelled():
                    error = saving.exception()
                    refusal = refusal_of(error) if isinstance(error, SimulshotError) else None
                    await self._channel.send(refusal or ImageAck(sha256=saving.result()))
            self._waiting.task_done()
