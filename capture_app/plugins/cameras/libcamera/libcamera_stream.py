"""The process-wide libcamera manager, and requests of its cameras: filled, passed on, and queued again.

Timestamps are converted to the host's monotonic clock. libcamera documents CLOCK_BOOTTIME; stamps by the
kernel's V4L2 are in CLOCK_MONOTONIC. The two differ only by the time that the machine has slept.
"""

import asyncio
import functools
import mmap
import os
import re
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import count
from typing import Any

from capture_app.cameras.base import wait_for_start
from capture_app.cameras.frames import JpegPicture, PixelFormat, PixelPicture, picture_from_buffer
from capture_app.cameras.system_packages import load_system_module
from capture_app.common import system
from capture_app.common.errors import CameraError, NotAvailableError
from capture_app.plugins.cameras.libcamera.configuration import KnownControls

_METADATA = (
    "SensorTimestamp",
    "FrameDuration",
    "ExposureTime",
    "AnalogueGain",
    "ColourGains",
    "ColourTemperature",
    "LensPosition",
)
PACKAGE = "python3-libcamera"
MIN_VERSION = (0, 4)
"""The oldest version that was tested."""


class Library:
    """libcamera's Python module with its camera manager, of which a process has one."""

    def __init__(self, module: Any) -> None:
        """Connect to the camera manager. Raises NotAvailableError if the library is too old."""
        self.module = module
        self._manager = module.CameraManager.singleton()
        version = str(self._manager.version)
        match = re.match(r"v?(\d+)\.(\d+)", version)
        if match is None or (int(match[1]), int(match[2])) < MIN_VERSION:
            raise NotAvailableError(
                f"libcamera {version} is too old: {'.'.join(map(str, MIN_VERSION))} or newer is needed",
                hint="install Debian 13 or an up-to-date Raspberry Pi OS",
            )
        self.handlers: dict[int, Callable[[Any], None]] = {}
        """Functions that are called with each request that finishes, by its cookie."""
        self.cookies = count()
        """Cookies for new requests."""

    @property
    def cameras(self) -> list[Any]:
        """All cameras that libcamera has found."""
        return list(self._manager.cameras)

    def camera(self, device: str) -> Any:
        """Return the camera with that id or number in the list. Raises CameraError."""
        cameras = self.cameras
        for number, camera in enumerate(cameras):
            if device in (camera.id, str(number)):
                return camera
        raise CameraError(
            f"libcamera knows no camera {device}",
            hint=f"it knows {', '.join(camera.id for camera in cameras) or 'none'};"
            " `capture-app cameras` lists them",
        )

    def listen(self) -> None:
        """Dispatch finished requests on the running event loop, until `hush` finds no handler left."""
        asyncio.get_running_loop().add_reader(self._manager.event_fd, self.dispatch)

    def hush(self) -> None:
        """Stop dispatching once no handler is left."""
        if not self.handlers:
            asyncio.get_running_loop().remove_reader(self._manager.event_fd)

    def dispatch(self) -> None:
        """Call the handlers of all finished requests."""
        for request in self._manager.get_ready_requests():
            if handler := self.handlers.get(request.cookie):
                handler(request)


_library_of = functools.cache(Library)


def load_library() -> Library:
    """Return the library of this process. Raises NotAvailableError if it is missing, too old, or broken."""
    # It logs to stderr, where users read this program's messages.
    os.environ.setdefault("LIBCAMERA_LOG_LEVELS", "*:FATAL")
    module = load_system_module("libcamera", PACKAGE, "a camera of libcamera")
    return _library_of(module)


class StampClock:
    """Conversion of libcamera's timestamps to the host's monotonic clock."""

    _asleep_ns = 0

    def now_ns(self) -> int:
        """Return the monotonic clock's time."""
        return system.monotonic_ns()

    def boot_ns(self) -> int:
        """Return the time of the clock that keeps running while the machine sleeps."""
        return time.clock_gettime_ns(time.CLOCK_BOOTTIME)

    def monotonic_of(self, stamp_ns: int) -> int | None:
        """Return the monotonic time in ns of a stamp that just arrived; None if it is in another clock."""
        now_ns = self.now_ns()
        asleep_ns = self.boot_ns() - now_ns
        # Two consecutive clock readings differ by less than a millisecond; a sleep lasts longer.
        if abs(asleep_ns - self._asleep_ns) > 1_000_000:
            self._asleep_ns = asleep_ns
        nearest_ns = min(stamp_ns, stamp_ns - self._asleep_ns, key=lambda ns: abs(now_ns - ns))
        # A stamp a minute from now is in neither clock.
        return nearest_ns if abs(now_ns - nearest_ns) < 60_000_000_000 else None


@dataclass(frozen=True, slots=True)
class FinishedFrame:
    """Frame and metadata of a finished request."""

    sequence: int
    stamp_ns: int | None
    """In the monotonic clock; None for a stamp in no clock of this machine."""
    metadata: dict[str, Any]
    """The library's metadata by control name; durations and exposures in us."""
    picture: JpegPicture | PixelPicture | None
    """None if it is damaged."""


class RequestStream:
    """Requests of a configured camera. `start`, `start_again_at` and `release` block."""

    def __init__(
        self,
        library: Library,
        camera: Any,
        stream: Any,
        layout: PixelFormat,
        controls: KnownControls,
        *,
        period_us: int,
        clock: StampClock,
        on_event: Callable[[FinishedFrame | RuntimeError], None],
    ) -> None:
        """Allocate its buffers; `on_event` is called with each frame, or with the error that ends the stream.

        It is called on the loop that the library listens on.

        Raises RuntimeError from the library, OSError.
        """
        self._library, self._clock, self._on_event = library, clock, on_event
        self._controls, self._layout, self.camera = controls, layout, camera
        self._allocator = library.module.FrameBufferAllocator(camera)
        self._allocator.allocate(stream)
        self.requests: list[Any] = []
        """All requests; new settings cannot affect ones that are queued already."""
        lengths: dict[int, int] = {}
        for buffer in self._allocator.buffers(stream):
            for plane in buffer.planes:
                lengths[plane.fd] = max(lengths.get(plane.fd, 0), plane.offset + plane.length)
            request = camera.create_request(next(library.cookies))
            request.add_buffer(stream, buffer)
            library.handlers[request.cookie] = partial(self._finish, buffer)
            self.requests.append(request)
        self._memory = {
            fd: mmap.mmap(fd, length, mmap.MAP_SHARED, mmap.PROT_READ) for fd, length in lengths.items()
        }
        self.settings: dict[str, Any] = {}
        """Settings in effect, by the library's control names."""
        self._new_settings: dict[str, Any] = {}
        self.asked_us: deque[int] = deque()
        """Requested durations in us, each for one coming frame."""
        self.period_us = period_us
        """Duration in us of frames without a requested one."""
        self.running = False
        """Whether frames are passed on."""

    def keep(self, settings: dict[str, Any], *, forget: tuple[str, ...] = ()) -> None:
        """Apply settings from the next request on, and after restarts; drop those in `forget`."""
        for pending in (self.settings, self._new_settings):
            for name in forget:
                pending.pop(name, None)
            pending |= settings

    def start(self) -> None:
        """Start the stream. Raises RuntimeError from the library."""
        self.asked_us.clear()
        self._new_settings = {}
        self.camera.start(self._next_settings(self.settings))
        for request in self.requests:
            self.camera.queue_request(request)

    def start_again_at(self, start_ns: int, period_ns: int, closing: threading.Event) -> None:
        """Start at `start_ns` (monotonic clock), or whole periods later; do nothing once `closing` is set."""
        for request in self.requests:
            request.reuse()
        if wait_for_start(start_ns - self._clock.now_ns(), period_ns, closing):
            self.start()

    def release(self) -> None:
        """Release the buffers and the camera, which must be stopped."""
        for request in self.requests:
            self._library.handlers.pop(request.cookie, None)
        self.requests, self._allocator = [], None
        for memory in self._memory.values():
            memory.close()
        self.camera.release()

    def _next_settings(self, settings: dict[str, Any]) -> dict[Any, Any]:
        """Return the settings that the camera knows and its next duration, keyed as the library requires."""
        duration_us = self.asked_us.popleft() if self.asked_us else self.period_us
        settings = {**settings, "FrameDurationLimits": (duration_us, duration_us)}
        return {self._controls[name][0]: settings[name] for name in settings if name in self._controls}

    def _finish(self, buffer: Any, request: Any) -> None:
        if not self.running or request.status != self._library.module.Request.Status.Complete:
            return
        metadata = {
            control.name: value for control, value in request.metadata.items() if control.name in _METADATA
        }
        is_sound = buffer.metadata.status == self._library.module.FrameMetadata.Status.Success
        planes = zip(buffer.planes, buffer.metadata.planes, strict=True) if is_sound else ()
        data = b"".join(
            self._memory[plane.fd][plane.offset : plane.offset + used.bytes_used] for plane, used in planes
        )
        event: FinishedFrame | RuntimeError = FinishedFrame(
            sequence=buffer.metadata.sequence,
            stamp_ns=self._clock.monotonic_of(metadata.get("SensorTimestamp", buffer.metadata.timestamp)),
            metadata=metadata,
            picture=picture_from_buffer(data, self._layout),
        )
        request.reuse()
        settings, self._new_settings = self._new_settings, {}
        for control, value in self._next_settings(settings).items():
            request.set_control(control, value)
        try:
            self.camera.queue_request(request)
        except RuntimeError as error:
            event = error
        self._on_event(event)
