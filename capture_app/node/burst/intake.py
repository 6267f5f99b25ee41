"""A leader's disk as its bursts see it: threads that wait for it, and a queue of images to each session."""

import asyncio
import functools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import islice
from typing import ParamSpec, TypeVar

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


class Intake:
    """The images of one burst that wait for the disk: all that come during one sync share the next."""

    def __init__(self, writer: SessionWriter, disk: DiskThreads, *, in_videos: bool) -> None:
        self._writer, self._disk, self._in_videos = writer, disk, in_videos
        self._waiting: dict[asyncio.Future[str], tuple[StoredImage, float]] = {}
        """By what is answered, the images in the order that they came, and when that was."""
        self._work: asyncio.Task[None] | None = None

    def add(self, image: StoredImage) -> "asyncio.Future[str]":
        """Save an image; what is returned has its checksum once it is safe, or what went wrong."""
        loop = asyncio.get_running_loop()
        saved: asyncio.Future[str] = loop.create_future()
        self._waiting[saved] = image, loop.time()
        if self._work is None:
            self._work = asyncio.create_task(self._save_all())
        return saved

    def waiting(self) -> tuple[int, float]:
        """How many images wait for the disk, and since how many seconds the first of them does."""
        now_s = asyncio.get_running_loop().time()
        since_s = next((since_s for _, since_s in self._waiting.values()), now_s)
        return len(self._waiting), now_s - since_s

    async def _save_all(self) -> None:
        try:
            while self._waiting:
                batch = [(saved, image) for saved, (image, _) in islice(self._waiting.items(), MAX_BATCH)]
                images = [image for _, image in batch]
                errors = await self._disk.call(self._writer.save, images, in_videos=self._in_videos)
                for (saved, image), error in zip(batch, errors, strict=True):
                    del self._waiting[saved]
                    if saved.done():
                        continue  # nobody waits for it any more
                    if error is None:
                        saved.set_result(image.record.sha256)
                    else:
                        saved.set_exception(error)
        finally:
            for saved in self._waiting:
                saved.cancel()
            self._waiting, self._work = {}, None
