"""Base of cameras with blocking drivers: a worker runs the calls, and threads report to the event loop."""

import asyncio
import contextlib
import threading
from abc import abstractmethod
from collections.abc import Callable
from concurrent.futures import Executor, ThreadPoolExecutor
from typing import TypeVar

from capture_app.cameras.base import Camera, OnFailure, OnFrame
from capture_app.cameras.frames import CapturedFrame
from capture_app.common.errors import CameraError

T = TypeVar("T")


class ThreadedCamera(Camera):
    """A camera with its own worker, so that a busy default executor never delays its calls."""

    _loop: asyncio.AbstractEventLoop
    _was_started = False

    def __init__(self, name: str, worker: Executor | None = None) -> None:
        """Create the worker; its threads are named `name`."""
        self._worker = worker or ThreadPoolExecutor(max_workers=1, thread_name_prefix=name)
        self._closing = threading.Event()

    def listen(self, on_frame: OnFrame, on_failure: OnFailure) -> None:
        """Store the callbacks and the running loop that calls them. Raises CameraError the second time."""
        if self._closing.is_set() or self._was_started:
            raise CameraError("the camera was started already", hint="open it again")
        self._loop, self._was_started = asyncio.get_running_loop(), True
        super().listen(on_frame, on_failure)

    async def stop(self) -> None:
        """Stop streaming and release the device. Calling it twice is harmless."""
        if not self._closing.is_set():
            self._closing.set()
            await self._let_go()
            self._worker.shutdown(wait=False)

    @abstractmethod
    async def _let_go(self) -> None:
        """Release what the camera holds; `_closing` is set by then."""

    def _in_worker(self, work: Callable[..., T], *arguments: object) -> "asyncio.Future[T]":
        return asyncio.get_running_loop().run_in_executor(self._worker, work, *arguments)

    def _call_in_loop(self, callback: Callable[..., object], *what: object) -> None:
        """Have the loop call `callback`; safe from any thread."""
        with contextlib.suppress(RuntimeError):  # the loop is closed: the process ends
            self._loop.call_soon_threadsafe(callback, *what)

    def _deliver(self, frame: CapturedFrame) -> None:
        if not self._closing.is_set():
            self._on_frame(frame)
