"""Webcams through OpenCV's VideoCapture: DirectShow on Windows, AVFoundation on macOS, Video4Linux on Linux.

OpenCV is installed anyway, on all three. Its headless wheels leave out Media Foundation (opencv-python's
setup.py), and it drops the timestamps of the other two. A frame's time is therefore its arrival, late by a
delay that only a measurement shows.

Video4Linux passes a camera's JPEGs on as they are. Windows and macOS decode them, so they are encoded again.
"""

import sys
from collections.abc import Iterable, Mapping
from contextlib import ExitStack, suppress
from functools import partial
from itertools import pairwise
from statistics import median
from subprocess import SubprocessError
from typing import Any

from capture_app.cameras.base import Camera, OnFailure, OnFrame, ThreadedCamera
from capture_app.cameras.frame_reader import FrameReader
from capture_app.cameras.frames import (
    CapturedFrame,
    PixelFormat,
    PixelPicture,
    every_nth,
    picture_from_buffer,
)
from capture_app.cameras.specs import DEFAULT_FPS, CameraRequest, read_request
from capture_app.common import system
from capture_app.common.camera_facts import (
    DELIVERY_NS,
    CameraFacts,
    CameraListing,
    PhaseControl,
    StampAccuracy,
    StampSource,
    TimestampSource,
)
from capture_app.common.clock import NodeClock
from capture_app.common.errors import CameraError, NotAvailableError
from capture_app.plugins.cameras.webcam.device_names import camera_names
from capture_app.sync.wire.camera_commands import CameraCommand

KIND = "webcam"
SPEC = f"{KIND}:NUMBER_OR_NAME[,key=value…]"
HELP = "Webcams of Windows, macOS and Linux; on Linux, v4l2 is more accurate."
NEEDS = ""
OPTIONS = {
    "width": "pixels of the picture",
    "height": "the same",
    "fps": "frames a second",
    "format": "pixel format, such as MJPG; not on macOS",
}
RATE_FRAMES, RATE_FRACTION = 20, 0.03
"""Number of first frames whose arrivals show the rate, and the relative tolerance of a requested one."""
SILENCE_NS, WAIT_PERIODS, MAX_DELAY_PERIODS = 5_000_000_000, 0.5, 5
"""Time without a frame after which a camera counts as lost; minimum wait for a frame that is taken on arrival
(one that is there at once had been buffered); assumed maximum delay from a frame's start of exposure to its
arrival, besides `DELIVERY_NS`.

The delay is one period each for the exposure, the readout and the transfer, which last no longer at this
rate, one for the system's decoder, and one for a frame that the system's graph or session holds.
"""
_SYSTEMS = {
    "win32": (
        "CAP_DSHOW",
        "DirectShow",
        "end other programs that use it, and allow desktop apps to: Settings, Privacy & security, Camera",
    ),
    "darwin": (
        "CAP_AVFOUNDATION",
        "AVFoundation",
        "allow this terminal to use it: System Settings, Privacy & Security, Camera; then start this again",
    ),
    "linux": (
        "CAP_V4L2",
        "Video4Linux",
        "`capture-app cameras` lists the cameras and whether they are in use",
    ),
}
"""OpenCV's backend on each system, the name of its interface, and the remedy if a camera does not open."""


class WebcamCamera(ThreadedCamera):
    """A camera that OpenCV opens by its number, when it is started."""

    def __init__(self, number: int, model: str, request: CameraRequest) -> None:
        """Create the camera without opening it. Raises NotAvailableError if this OpenCV opens no webcams."""
        import cv2

        super().__init__(KIND)
        self._number, self._model, self._request = number, model, request
        self._label, self._held, self._sequence = f"{KIND}:{number} ({model})", ExitStack(), 0
        self._backend, interface, self._remedy = _SYSTEMS.get(
            sys.platform, ("", f"an interface for {sys.platform}", "")
        )
        if not (self._backend and cv2.videoio_registry.hasBackend(getattr(cv2, self._backend))):
            raise NotAvailableError(
                f"webcams need {interface}, which this machine's OpenCV is built without",
                hint="python -m pip install --force-reinstall opencv-python-headless",
            )

    async def start(self, on_frame: OnFrame, on_failure: OnFailure) -> None:
        """Open and stream. Raises CameraError if it is missing, busy, sends nothing or in another mode."""
        self.listen(on_frame, on_failure)
        await self._in_worker(self._open)
        self._begun.set_result(None)
        reader = FrameReader(
            self._read,
            self._take,
            lambda error: self._fail(CameraError(str(error), hint="unplug it and plug it in again")),
            period_ns=self.facts.period_ns,
            buffers=1,
        )
        self._held.callback(reader.join)
        self._held.callback(reader.stop)

    async def apply(self, command: CameraCommand) -> None:
        """Raise CameraError: OpenCV neither times the start of a stream nor lengthens a frame."""
        raise CameraError(f"the stream of {self._label} cannot be moved")

    async def _let_go(self) -> None:
        await self._in_worker(self._held.close)

    def _open(self) -> None:
        """Open the device, request its settings, and find out what it delivers. Raises CameraError."""
        import cv2

        asked, first = self._request, list[tuple[int, int, Any]]()
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
        self._capture = cv2.VideoCapture(self._number, getattr(cv2, self._backend))
        self._held.callback(self._capture.release)
        if not self._capture.isOpened():
            raise CameraError(
                f"{self._label} does not open: missing, in use or not allowed", hint=self._remedy
            )
        for setting, value in (
            (cv2.CAP_PROP_FRAME_WIDTH, asked.size[0]),
            (cv2.CAP_PROP_FRAME_HEIGHT, asked.size[1]),
            (cv2.CAP_PROP_FPS, asked.fps or DEFAULT_FPS),
            # The last one, because DirectShow's setters of size and rate forget it.
            (cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*f"{asked.format or 'MJPG':4.4}".upper())),
        ):
            self._capture.set(setting, value)
        fourcc = int(self._capture.get(cv2.CAP_PROP_FOURCC)) & 0xFFFF_FFFF
        pixel_format = fourcc.to_bytes(4, "little").decode("ascii", "ignore").strip("\0 ")
        # Only Video4Linux can deliver the camera's own JPEGs.
        self._capture.set(
            cv2.CAP_PROP_CONVERT_RGB, 1 - ((self._backend, pixel_format) == ("CAP_V4L2", "MJPG"))
        )
        self._heard_ns = system.monotonic_ns()
        try:
            while len(first) <= RATE_FRAMES:
                first += self._read()
        except TimeoutError as error:
            raise CameraError(str(error), hint=self._remedy) from error
        self._last_ns, _, image = first[-1]
        self._late_ns = 0
        actual = 1e9 / median(after[0] - before[0] for before, after in pairwise(first))
        fps = next(
            rate
            for rate in (asked.fps or DEFAULT_FPS, round(actual), actual)
            if abs(rate / actual - 1) < RATE_FRACTION
        )
        width, height = (
            image.shape[1::-1]
            if image.ndim == 3
            else (
                round(self._capture.get(side))
                for side in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
            )
        )
        if any(
            request not in (None, delivered)
            for request, delivered in (
                (asked.width, width),
                (asked.height, height),
                (asked.fps, fps),
                (asked.format and asked.format.upper(), pixel_format),
            )
        ):
            raise CameraError(
                f"{self._label} does not deliver what was requested",
                hint=f"it delivers {pixel_format} {width}x{height} at {fps:.4g} fps, in this light",
            )
        half_ns = (round(MAX_DELAY_PERIODS * 1e9 / fps) + DELIVERY_NS) // 2
        self._facts = CameraFacts(
            kind=KIND,
            model=self._model,
            width=width,
            height=height,
            pixel_format=pixel_format,
            period_ns=round(1e9 / fps),
            timestamp_source=TimestampSource.UNKNOWN,
            phase_control=PhaseControl.NONE,
            stamp=StampAccuracy(bias_ns=half_ns, uncertainty_ns=half_ns, source=StampSource.ASSUMED),
        )

    def _read(self) -> Iterable[tuple[int, int, Any]]:
        """Wait for a frame; return its arrival, the wait (both ns) and its pixels or bytes.

        Raises TimeoutError if none has come for a while.
        """
        begun_ns = system.monotonic_ns()
        # DirectShow waits for a frame in `retrieve` and the others in `grab`; `read` is both.
        is_there, image = self._capture.read()
        now_ns = system.monotonic_ns()
        self._heard_ns = now_ns if is_there else self._heard_ns
        if now_ns - self._heard_ns > SILENCE_NS:
            raise TimeoutError(f"{self._label} sends no frames")
        return ((now_ns, now_ns - begun_ns, image),) if is_there else ()

    def _take(self, arrival: tuple[int, int, Any]) -> None:
        """Deliver a frame with the uncertainty of its arrival; the delay before that is in the facts."""
        (arrival_ns, wait_ns, image), facts = arrival, self.facts
        gap_ns = arrival_ns - self._last_ns
        self._sequence += max(1, round(gap_ns / facts.period_ns))
        self._last_ns = arrival_ns
        # A frame that was waited for is late by as much as the thread woke up late, or frames before it were
        # dropped. One that was buffered arrived at any time since the frame before it did.
        self._late_ns = (
            abs(gap_ns - facts.period_ns)
            if wait_ns > WAIT_PERIODS * facts.period_ns
            else self._late_ns + gap_ns
        )
        picture = (
            PixelPicture(image.nbytes, partial(every_nth, image))
            if image.ndim == 3
            else picture_from_buffer(
                image.tobytes(), PixelFormat(facts.pixel_format, facts.width, facts.height, 0)
            )
        )
        # The number of a damaged JPEG is missing from the stream, as with any dropped frame.
        if picture is not None:
            self._on_frame(
                CapturedFrame(
                    sequence=self._sequence,
                    stream=0,
                    timestamp_ns=arrival_ns,
                    picture=picture,
                    clock_uncertainty_ns=self._late_ns,
                )
            )


def open_camera(device: str, options: Mapping[str, str], *, clock: NodeClock, name: str) -> Camera:
    """Create a webcam from its number or name; it is opened when it is started.

    Raises BadInputError for an option that cannot be read, CameraError for a name that no camera or more than
    one has, NotAvailableError if OpenCV cannot open webcams on this machine.
    """
    names: dict[int, str] = {}
    with suppress(OSError, ValueError, SubprocessError):
        names = camera_names()
    number = int(device) if device.isdecimal() else number_of(device, names)
    model = names.get(number) or f"webcam {number}"
    return WebcamCamera(number, model, read_request(options, "a webcam")).in_clock(clock)


def number_of(device: str, names: Mapping[int, str]) -> int:
    """Return the number of the camera with this name, or else with this part of its name, in any case.

    Raises CameraError if there is none, or more than one.
    """
    asked, known = device.casefold(), {number: name.casefold() for number, name in names.items()}
    numbers = [number for number, name in known.items() if name == asked] or [
        number for number, name in known.items() if asked in name
    ]
    if len(numbers) != 1:
        listed = " or ".join(f"{KIND}:{number} ({names[number]})" for number in numbers or names)
        raise CameraError(
            f"{len(numbers)} webcams are called {device!r}" if numbers else f"no webcam is called {device!r}",
            hint=f"write {listed or f'{KIND}:0: this machine tells no names'}",
        )
    return numbers[0]


def list_cameras() -> list[CameraListing]:
    """Return the webcams of Windows and macOS; none on Linux, where v4l2 lists the same cameras.

    Nothing is opened, so their modes are not known.
    """
    return [
        CameraListing(f"{KIND}:{number}", KIND, name, "append ,width=…,height=…,fps=… for a mode")
        for number, name in ({} if sys.platform == "linux" else camera_names()).items()
    ]
