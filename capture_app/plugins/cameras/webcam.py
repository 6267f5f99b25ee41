"""Webcams through OpenCV: a thread waits for frames and stamps them as they arrive."""

import asyncio
import contextlib
import functools
import platform
import threading
import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from capture_app.cameras.base import Camera, OnFailure, OnFrame, ThreadedCamera, wait_for_start
from capture_app.cameras.frames import CapturedFrame, PixelPicture, every_nth
from capture_app.cameras.specs import DEFAULT_FPS, CameraRequest, read_request
from capture_app.common.camera_facts import CameraFacts, CameraListing, PhaseControl, TimestampSource
from capture_app.common.clock import NodeClock
from capture_app.common.errors import BadInputError, CameraError
from capture_app.session.reading.decoding import open_capture
from capture_app.sync.wire.camera_commands import CameraCommand, RestartStream

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

KIND = "webcam"
SPEC = f"{KIND}:NUMBER[,key=value…]"
HELP = "Webcams by OpenCV, on systems other than Linux."
NEEDS = ""
OPTIONS = {
    "width": "pixels of the picture; a webcam may choose another size",
    "height": "the same",
    "fps": "frames a second; a webcam may choose another rate",
}
MAX_MISSES, MISS_PAUSE_S = 10, 0.05
"""Consecutive missing frames after which the webcam counts as disconnected, and the pause after each."""


class Webcam:
    """An open webcam, which streams from the start."""

    def __init__(self, index: int, request: CameraRequest) -> None:
        """Open it by its number. Raises CameraError if it is missing or in use."""
        import cv2

        self.index = index
        self._capture = open_capture(index)
        if not self._capture.isOpened():
            raise CameraError(
                f"webcam {index} does not open",
                hint="check its number, close other programs that use it, and let this one use cameras",
            )
        for prop, value in (
            (cv2.CAP_PROP_FRAME_WIDTH, request.width),
            (cv2.CAP_PROP_FRAME_HEIGHT, request.height),
            (cv2.CAP_PROP_FPS, request.fps),
        ):
            if value is not None:
                self._capture.set(prop, value)
        reported_fps = float(self._capture.get(cv2.CAP_PROP_FPS))
        self.fps = reported_fps if 0.1 <= reported_fps <= 1000.0 else request.fps or DEFAULT_FPS

    def next_frame(self) -> "tuple[int, NDArray[np.uint8]] | None":
        """Wait for a frame; return its arrival (ns, host's clock) and BGR (H, W, 3), or None without one."""
        if not self._capture.grab():
            return None
        arrived_ns = time.monotonic_ns()
        good, image = self._capture.retrieve()
        return (arrived_ns, image) if good else None

    def close(self) -> None:
        """Release the webcam."""
        self._capture.release()


class WebcamCamera(ThreadedCamera):
    """A webcam as a camera; it is opened when started, and reopened to restart its stream."""

    def __init__(self, open_webcam: Callable[[], Webcam]) -> None:
        """Create the camera; `open_webcam` may block and is called on this camera's thread."""
        super().__init__(KIND)
        self._open_webcam = open_webcam
        self._thread: threading.Thread | None = None
        self._restart_ns: int | None = None
        self._restarted: asyncio.Future[None] | None = None

    async def start(self, on_frame: OnFrame, on_failure: OnFailure) -> None:
        """Open the webcam and stream. Raises CameraError if it is missing or delivers no frames."""
        self.listen(on_frame, on_failure)
        self._thread = threading.Thread(target=self._run, name="webcam", daemon=True)
        self._thread.start()
        await self._begun

    async def apply(self, command: CameraCommand) -> None:
        """Restart the stream by reopening the webcam; the delay counts from this call.

        Raises CameraError for any other command, or without a stream.
        """
        asked_ns = time.monotonic_ns()
        if not isinstance(command, RestartStream):
            raise CameraError("a webcam cannot change single frames", hint="restart its stream instead")
        if self._thread is None or not self._thread.is_alive() or self._closing.is_set() or self._has_failed:
            raise CameraError("the webcam does not stream")
        self._restarted = self._loop.create_future()
        self._restart_ns = asked_ns + command.delay_ns
        await self._restarted

    async def _let_go(self) -> None:
        _complete(self._restarted)
        if self._thread is not None:
            await self._in_worker(self._thread.join)

    def _run(self) -> None:
        """Open the webcam and stream until it is stopped or fails."""
        webcam: Webcam | None = None
        try:
            webcam = self._open_webcam()
            height, width = self._next(webcam)[1].shape[:2]
            # Its exposure and the moment that an arrival marks are unknown.
            self._facts = CameraFacts(
                kind=KIND,
                model=f"Webcam {webcam.index}",
                width=width,
                height=height,
                period_ns=round(1e9 / webcam.fps),
                timestamp_source=TimestampSource.UNKNOWN,
                phase_control=PhaseControl.RESET,
            )
            self._call_in_loop(_complete, self._begun)
            stream, sequence = 0, -1
            while not self._closing.is_set():
                if self._restart_ns is not None:
                    webcam.close()
                    wait_for_start(
                        self._restart_ns - time.monotonic_ns(), self.facts.period_ns, self._closing
                    )
                    webcam = self._open_webcam()
                    self._restart_ns = None
                    self._call_in_loop(_complete, self._restarted)
                    stream, sequence = stream + 1, -1
                arrived_ns, pixels = self._next(webcam)
                sequence += 1
                picture = PixelPicture(pixels.nbytes, functools.partial(every_nth, pixels))
                self._call_in_loop(self._deliver, CapturedFrame(sequence, stream, arrived_ns, picture))
        except CameraError as error:
            self._call_in_loop(self._fail, error)
        finally:
            if webcam is not None:
                webcam.close()

    def _next(self, webcam: Webcam) -> "tuple[int, NDArray[np.uint8]]":
        for _ in range(MAX_MISSES):
            if (found := webcam.next_frame()) is not None:
                return found
            if self._closing.wait(MISS_PAUSE_S):
                break
        raise CameraError(
            f"webcam {webcam.index} gives no pictures", hint="check its plug, then start it again"
        )

    def _fail(self, error: CameraError) -> None:
        # The thread still closes the webcam, but restarts nothing any more.
        _complete(self._restarted)
        super()._fail(error)


def _complete(awaited: asyncio.Future[None] | None) -> None:
    if awaited is not None and not awaited.done():
        awaited.set_result(None)


def open_camera(number: str, options: Mapping[str, str], *, clock: NodeClock, name: str) -> Camera:
    """Create a webcam from its number; it is opened when it is started.

    Raises BadInputError if `number` is not one, or for an option that cannot be read.
    """
    if not (number.isascii() and number.isdecimal() and int(number) < 256):
        raise BadInputError(f"webcam:{number} is not a webcam", hint="they have numbers: webcam:0")
    open_webcam = functools.partial(Webcam, int(number), read_request(options, "a webcam"))
    return WebcamCamera(open_webcam).in_clock(clock)


def list_cameras() -> list[CameraListing]:
    """Return the webcams by number; none on Linux, where the V4L2 driver has far better timestamps."""
    if platform.system() == "Linux":
        return []
    found = []
    with contextlib.suppress(CameraError):
        for index in range(8):
            Webcam(index, CameraRequest()).close()
            detail = "by OpenCV: stamped on arrival, accurate to tens of milliseconds"
            found.append(CameraListing(f"{KIND}:{index}", KIND, f"Webcam {index}", detail))
    return found
