"""Images that have come, on their way to the disk: all that arrive during one sync share the next."""

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass

from capture_app.errors import SimulshotError
from capture_app.session.format.manifest import ImageRecord
from capture_app.session.writing.received_image import ReceivedImage
from capture_app.session.writing.video_store import NewFrame

IncomingImage = ReceivedImage | NewFrame
MAX_BATCH = 128
"""So many images are synced together at most: the first of them waits for the last."""


@dataclass(frozen=True, slots=True)
class _Waiting:
    image: IncomingImage
    saved: "asyncio.Future[None]"
    since_s: float


class ImageCommits:
    """Those of one session; one batch after the other is saved, however many streams bring images."""

    def __init__(
        self,
        save: Callable[[Sequence[IncomingImage]], Awaitable[list[SimulshotError | None]]],
        on_saved: Callable[[ImageRecord], None],
    ) -> None:
        """`save` returns when images are safely on the disk, `on_saved` is told first."""
        self._save = save
        self._on_saved = on_saved
        self._queue: list[_Waiting] = []
        self._batch: list[_Waiting] = []
        self._work: asyncio.Task[None] | None = None

    def add(self, image: IncomingImage) -> "asyncio.Future[None]":
        """Save an image; what is returned is done, or has an error, when that has been done."""
        loop = asyncio.get_running_loop()
        waiting = _Waiting(image, loop.create_future(), loop.time())
        self._queue.append(waiting)
        if self._work is None:
            self._work = asyncio.create_task(self._save_all())
        return waiting.saved

    def waiting(self) -> tuple[int, float]:
        """How many images wait for the disk, and since how many seconds the first of them does."""
        all_waiting = [*self._batch, *self._queue]
        if not all_waiting:
            return 0, 0.0
        return len(all_waiting), asyncio.get_running_loop().time() - all_waiting[0].since_s

    async def wait_until_idle(self) -> None:
        """Wait until no image is being saved."""
        while self._work is not None:
            await asyncio.wait({self._work})

    async def _save_all(self) -> None:
        try:
            while self._queue:
                self._batch, self._queue = self._queue[:MAX_BATCH], self._queue[MAX_BATCH:]
                try:
                    errors = await self._save([waiting.image for waiting in self._batch])
                except SimulshotError as error:
                    errors = [error] * len(self._batch)
                for waiting, failure in zip(self._batch, errors, strict=True):
                    if failure is None:
                        self._on_saved(waiting.image.record)
                    if waiting.saved.done():
                        continue  # nobody waits for it any more
                    if failure is None:
                        waiting.saved.set_result(None)
                    else:
                        waiting.saved.set_exception(failure)
                self._batch = []
        finally:
            for waiting in (*self._batch, *self._queue):
                waiting.saved.cancel()
            self._batch, self._queue, self._work = [], [], None
