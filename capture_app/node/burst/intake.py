"""A leader's disk as its bursts see it: threads that wait for it, and a queue of images to each session."""

import asyncio
import functools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import ParamSpec, TypeVar

from capture_app.errors import SimulshotError
from capture_app.session.writing.image_store import StoredImage
from capture_app.session.writing.session_writer import SessionWriter

DISK_THREADS = 8
MAX_BATCH = 128
"""How many images are synced together at most: the first of them waits for the last."""

P = ParamSpec("P")
T = TypeVar("T")


class DiskThreads:
    """One pool for all bursts of a leader; its threads end with `close`."""

    def __init__(self) -> None:
        self._threads = ThreadPoolExecutor(DISK_THREADS, "disk")

    async def call(self, work: Callable[P, T], *arguments: P.args, **options: P.kwargs) -> T:
        """Do work that blocks on the disk, and return or raise what it does."""
        loop = asyncio.get_running_loop()
        return await loop.run_in_executor(self._threads, functools.partial(work, *arguments, **options))

    def close(self) -> None:
        """Take on no more work, and end when what was begun is done."""
        self._threads.shutdown(wait=False)


@dataclass(frozen=True, slots=True)
class _Waiting:
    """An image in the queue."""

    image: StoredImage
    saved: "asyncio.Future[str]"
    since_s: float


class Intake:
    """The images of one burst that wait for the disk: all that come during one sync share the next."""

    def __init__(self, writer: SessionWriter, disk: DiskThreads, *, in_videos: bool) -> None:
        self._writer, self._disk, self._in_videos = writer, disk, in_videos
        self._queue: list[_Waiting] = []
        self._batch: list[_Waiting] = []
        self._work: asyncio.Task[None] | None = None

    def add(self, image: StoredImage) -> "asyncio.Future[str]":
        """Save an image; what is returned has its checksum once it is safe, or what went wrong."""
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

    async def _save_all(self) -> None:
        try:
            while self._queue:
                self._batch, self._queue = self._queue[:MAX_BATCH], self._queue[MAX_BATCH:]
                images = [waiting.image for waiting in self._batch]
                errors = await self._disk.call(self._writer.save, images, in_videos=self._in_videos)
                for waiting, error in zip(self._batch, errors, strict=True):
                    _answer(waiting, error)
                self._batch = []
        finally:
            for waiting in (*self._batch, *self._queue):
                waiting.saved.cancel()
            self._batch, self._queue, self._work = [], [], None


def _answer(waiting: _Waiting, error: SimulshotError | None) -> None:
    if waiting.saved.done():
        return  # nobody waits for it any more
    if error is None:
        waiting.saved.set_result(waiting.image.record.sha256)
    else:
        waiting.saved.set_exception(error)
