"""Cameras of libcamera: listed, opened, restarted, and moved by the durations of single frames.

The driver reports neither the row time nor the value at which the automatic exposure settles. Both are
measured in the first two seconds of a stream, before its frames are passed on. The exposure is then fixed.
A frame lasts a whole number of rows, so a requested duration is reported shorter by up to one row, truncated
to microseconds. The row time is the one of which all reported durations are whole multiples.
"""

import asyncio
import random
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import Executor
from contextlib import suppress
from itertools import pairwise
from math import ceil, floor
from statistics import median
from typing import Any

from msgspec import structs

from capture_app.cameras.base import Camera, OnFailure, OnFrame, ThreadedCamera
from capture_app.cameras.frames import CapturedFrame
from capture_app.cameras.specs import CameraRequest
from capture_app.cameras.system_packages import is_installed
from capture_app.common.camera_facts import CameraListing, Control, ControlState, PhaseControl
from capture_app.common.clock import NodeClock
from capture_app.common.errors import CameraError, NotAvailableError
from capture_app.plugins.cameras.libcamera.configuration import (
    FOURCC,
    KIND,
    configure,
    facts_as_configured,
    first_exposure,
    held_exposure,
    new_settings,
    origin_of,
    parse_options,
    properties_of,
    read_states,
    typical_period_ns,
    with_exposure,
)
from capture_app.plugins.cameras.libcamera.libcamera_stream import (
    PACKAGE,
    FinishedFrame,
    Library,
    RequestStream,
    StampClock,
    load_library,
)
from capture_app.sync.wire.camera_commands import CameraCommand, RestartStream, SetFrameDuration

ASKED = 32
"""Number of different durations that leaves one solution, for rows of 5 us and longer."""
MIN_DURATIONS = 12
"""With fewer different durations, a row time could fit by chance."""
SPAN = 0.5
"""Max extension of the requested durations beyond the frame period, as a fraction of it."""
LONGEST_ROW_US = 250.0
SHORTEST_ROW_US = 5.0
_BELOW_US, _ABOVE_US = 0.5, 1.0
"""Rounding error of reports: up to 0.5 us too long if rounded, up to 1 us too short if truncated."""
SILENT_S = 5.0
"""A stream has failed without a frame for this long and for SILENT_PERIODS periods."""
SILENT_PERIODS = 30
IN_EFFECT_FRAMES = 6
"""Max number of frames, after the requests already queued, until a setting takes effect."""
UNSETTLED_FRAMES = 3
"""First frames after a start, whose metadata may be wrong."""
INSIDE_ROW = 0.25
"""Fraction of a row added to a requested duration, because a driver may truncate or round it."""
SPEC = f"{KIND}:ID[,key=value…]"
HELP = "Cameras of a Raspberry Pi and others that libcamera drives, by its id or number."
NEEDS = f"libcamera's Python bindings: sudo apt install {PACKAGE}"
OPTIONS = {
    "width": "pixels of the picture",
    "height": "the same",
    "fps": "frames a second",
    "exposure_us": "exposure, else the camera chooses it",
    "gain": "analogue gain, else the camera chooses it",
    "format": f"one of {', '.join(FOURCC.values())}",
}


def durations_to_ask_us(period_us: int, longest_us: int) -> list[int]:
    """Return frame durations in us from whose reported values the row time can be found."""
    # Random, because evenly spaced durations could all be multiples of two rows.
    span_us, rng = min(SPAN * period_us, longest_us - period_us), random.Random(1)
    return [period_us + round(span_us * rng.random()) for _ in range(ASKED)]


def find_row_time_us(reported_us: Iterable[int]) -> float | None:
    """Return the longest row time in us of which all reported frame durations are whole multiples.

    None if there is no such time, or the durations are too few or too similar.
    """
    durations = sorted(set(reported_us))
    if len(durations) < MIN_DURATIONS or durations[0] <= 0:
        return None
    bounds = [(SHORTEST_ROW_US, LONGEST_ROW_US)]
    for duration_us in durations:
        min_us, max_us = duration_us - _BELOW_US, duration_us + _ABOVE_US
        narrowed = [
            (max(low_us, min_us / rows), min(high_us, max_us / rows))
            for low_us, high_us in bounds
            for rows in range(floor(min_us / high_us) + 1, ceil(max_us / low_us))
        ]
        bounds = [(low_us, high_us) for low_us, high_us in narrowed if low_us < high_us]
    return sum(max(bounds)) / 2 if bounds else None


class LibcameraCamera(ThreadedCamera):
    """A camera of libcamera; `driver.open_camera` creates one."""

    def __init__(
        self,
        library: Library,
        device: str,
        wishes: CameraRequest,
        *,
        clock: StampClock | None = None,
        executor: Executor | None = None,
    ) -> None:
        """Acquire and configure a camera. Raises CameraError if it is missing, busy, or has no such mode."""
        super().__init__(KIND, executor)
        self._library, self._wishes, self._clock = library, wishes, clock or StampClock()
        camera = library.camera(device)
        self.id: str = camera.id
        self._command_lock = asyncio.Lock()
        self._streams = 0
        self._metadata: dict[str, Any] = {}
        self._first_frames: list[FinishedFrame] = []
        self._first_frames_requested: tuple[int, asyncio.Future[None]] | None = None
        try:
            camera.acquire()
        except RuntimeError as error:
            raise CameraError(
                f"{self.id} is in use by another program", hint="close it: a camera serves one at a time"
            ) from error
        try:
            self._configure(camera)
        except BaseException as error:
            camera.release()
            if isinstance(error, RuntimeError | OSError):
                raise CameraError(
                    f"{self.id} cannot be configured: {error}",
                    hint="leave out its options; the kernel log (`dmesg`) may say more",
                ) from error
            raise

    def _configure(self, camera: Any) -> None:
        stream, layout = configure(self._library.module, camera, self._wishes)
        controls = {control.name: (control, limits) for control, limits in camera.controls.items()}
        period_us, (_, limits) = self._wishes.period_us, controls.get("FrameDurationLimits", (None, None))
        self._limits_us = limits_us = None if limits is None else (limits.min, limits.max)
        if limits_us is None and self._wishes.fps is not None:
            raise CameraError(f"libcamera cannot set the frame rate of {self.id}", hint="leave out fps")
        if limits_us is not None and not limits_us[0] <= period_us <= limits_us[1]:
            raise CameraError(
                f"{self.id} cannot run at {1e6 / period_us:.4g} frames/s in this size",
                hint=f"from {1e6 / limits_us[1]:.3g} to {1e6 / limits_us[0]:.4g}",
            )
        self._controls, self._origin = controls, origin_of(camera)
        self._facts = facts_as_configured(camera, layout, self._wishes, limits_us)
        self._stream = RequestStream(
            self._library,
            camera,
            stream.stream,
            layout,
            controls,
            period_us=period_us,
            clock=self._clock,
            on_event=self._receive,
        )
        self._stream.keep(first_exposure(controls, self._wishes))

    async def start(self, on_frame: OnFrame, on_failure: OnFailure) -> None:
        """Start streaming and measure the first frames. Raises CameraError if none arrive."""
        self.listen(on_frame, on_failure)
        async with self._command_lock:
            self._library.listen()
            try:
                await self._in_worker(self._stream.start)
            except RuntimeError as error:
                raise CameraError(
                    f"{self.id} does not start: {error}",
                    hint="check its cable; the kernel log (`dmesg`) may say more",
                ) from error
            self._run()
            asyncio.get_running_loop().call_later(1.0, self._watch)
            if self._limits_us is None:
                await self._learn_period()
            else:
                await self._learn_rows(*self._limits_us)

    async def apply(self, command: CameraCommand) -> None:
        """Change the duration of one coming frame, or restart the stream after a delay from this call.

        If stopping takes longer than the delay, whole frame periods are added, so that the start keeps its
        phase. Raises CameraError for an unsupported command, or without a stream.
        """
        asked_ns = self._clock.now_ns()
        if isinstance(command, SetFrameDuration) and self.facts.phase_control is PhaseControl.FRAME_DURATION:
            self._stream.asked_us.append(round(command.duration_ns / 1000))
            return
        if not isinstance(command, RestartStream):
            raise CameraError(f"{self.id} cannot do that", hint="restart its stream instead")
        async with self._command_lock:
            if not self._stream.running:
                raise CameraError(f"{self.id} does not stream")
            self._stream.running = False
            try:
                await self._in_worker(self._stream.camera.stop)
                self._library.dispatch()
                await self._in_worker(
                    self._stream.start_again_at,
                    asked_ns + command.delay_ns,
                    self.facts.period_ns,
                    self._closing,
                )
            except RuntimeError as error:
                self._on_failure(
                    CameraError(
                        f"{self.id} does not start again: {error}", hint="it is tried again; check its cable"
                    )
                )
            else:
                if not self._closing.is_set():
                    self._run()

    async def controls(self) -> tuple[ControlState, ...]:
        """Return the controls that the camera has, with their values in its last frame."""
        return tuple(
            read_states(self._controls, self._stream.settings, self._metadata, self._stream.period_us)
        )

    async def set_control(self, control: Control, value: float | None) -> None:
        """Set a control, or let the camera choose it. Raises CameraError if it cannot be set."""
        settings, forget = new_settings(control, value, self._metadata)
        self._stream.keep(settings, forget=forget)
        self._facts = with_exposure(self.facts, self._stream.settings.get("ExposureTime"), self._origin)

    async def _let_go(self) -> None:
        self._stream.running = False
        with suppress(RuntimeError):
            await self._in_worker(self._stream.camera.stop)
        self._library.dispatch()
        await self._in_worker(self._stream.release)
        self._library.hush()

    # Measurements on the first frames

    async def _learn_rows(self, min_us: int, max_us: int) -> None:
        """Measure the row time, choose the number of rows nearest to the period, and fix the exposure."""
        period_us = self._wishes.period_us
        self._stream.asked_us.extend(durations_to_ask_us(period_us, max_us))
        in_effect = len(self._stream.requests) + IN_EFFECT_FRAMES
        seen = await self._next_frames(UNSETTLED_FRAMES + ASKED + in_effect)
        durations_us = (frame.metadata.get("FrameDuration") for frame in seen[UNSETTLED_FRAMES:])
        row_us = await self._in_worker(find_row_time_us, [us for us in durations_us if us is not None])
        if row_us is not None:
            rows = round(period_us / row_us)
            rows += rows * row_us < min_us
            period_us = round((rows + INSIDE_ROW) * row_us)
            row_ns = round(row_us * 1000)
            self._facts = structs.replace(
                self.facts,
                period_ns=rows * row_ns,
                row_time_ns=row_ns,
                phase_control=PhaseControl.FRAME_DURATION,
            )
        self._stream.period_us = period_us
        self._stream.keep(held_exposure(seen[-1].metadata, self._wishes))
        *_, last = await self._next_frames(in_effect)
        if "ExposureTime" in last.metadata:
            self._facts = with_exposure(self.facts, last.metadata["ExposureTime"], self._origin)

    async def _learn_period(self) -> None:
        """Measure the frame period of a camera whose frame durations cannot be set."""
        seen = (await self._next_frames(UNSETTLED_FRAMES + 15))[UNSETTLED_FRAMES:]
        stamps_ns = [frame.stamp_ns for frame in seen if frame.stamp_ns is not None]
        period_ns = typical_period_ns(median(b - a for a, b in pairwise(stamps_ns)))
        self._facts = with_exposure(
            structs.replace(self.facts, period_ns=period_ns), self._wishes.exposure_us, self._origin
        )

    async def _next_frames(self, count: int) -> list[FinishedFrame]:
        """Return the next `count` frames without passing them on. Raises CameraError if they never arrive."""
        self._first_frames, arrived = [], asyncio.get_running_loop().create_future()
        self._first_frames_requested = count, arrived
        try:
            await arrived
        finally:
            self._first_frames_requested = None
        return self._first_frames

    # Frames

    def _receive(self, frame: FinishedFrame | RuntimeError) -> None:
        if isinstance(frame, RuntimeError):
            self._fail(
                CameraError(
                    f"{self.id} does not answer any more: {frame}", hint="it is tried again; check its cable"
                )
            )
            return
        self._last_frame_ns, self._metadata = self._clock.now_ns(), frame.metadata
        if frame.stamp_ns is None:
            self._fail(
                CameraError(
                    f"the timestamps of {self.id} come from no clock of this machine",
                    hint="use another camera: this one cannot be synchronized",
                )
            )
        elif self._first_frames_requested is not None:
            count, arrived = self._first_frames_requested
            self._first_frames.append(frame)
            if len(self._first_frames) >= count and not arrived.done():
                arrived.set_result(None)
        elif frame.picture is not None:
            exposure_us, colours = frame.metadata.get("ExposureTime"), frame.metadata.get("ColourGains")
            self._on_frame(
                CapturedFrame(
                    sequence=frame.sequence,
                    stream=self._streams,
                    timestamp_ns=frame.stamp_ns,
                    picture=frame.picture,
                    exposure_ns=exposure_us * 1000 if exposure_us else None,
                    gain=frame.metadata.get("AnalogueGain"),
                    white_balance=(colours[0], colours[1]) if colours else None,
                )
            )

    def _run(self) -> None:
        """Pass frames on from now, as a new stream."""
        self._streams += 1
        self._last_frame_ns = self._clock.now_ns()
        self._stream.running = True

    def _watch(self) -> None:
        """Detect a stream without frames: the library does not report a disconnected camera."""
        if self._closing.is_set():
            return
        max_ns = max(SILENT_S * 1e9, SILENT_PERIODS * self.facts.period_ns)
        if self._clock.now_ns() - self._last_frame_ns > max_ns:
            self._fail(
                CameraError(
                    f"{self.id} delivers no frames any more", hint="check its cable, then start it again"
                )
            )
        asyncio.get_running_loop().call_later(1.0, self._watch)

    def _fail(self, error: CameraError) -> None:
        if not self._stream.running:
            return
        self._stream.running = False
        if self._first_frames_requested is None:
            self._on_failure(error)
        elif not self._first_frames_requested[1].done():
            self._first_frames_requested[1].set_exception(error)


def open_camera(device: str, options: Mapping[str, str], *, clock: NodeClock, name: str) -> Camera:
    """Open a camera by the library's id for it, or by its number in the list.

    See OPTIONS. Raises BadInputError for an option that cannot be read, CameraError if the camera is
    missing, busy or has no such mode, NotAvailableError if the library is missing or too old.
    """
    return LibcameraCamera(load_library(), device, parse_options(options)).in_clock(clock)


def list_cameras() -> list[CameraListing]:
    """Return the library's cameras that V4L2 does not drive, or one entry with the load error."""
    if not is_installed("libcamera"):
        return []
    try:
        library = load_library()
    except NotAvailableError as error:
        return [CameraListing(f"{KIND}:0", KIND, "", str(error), usable=False)]
    return list(listings(library))


def listings(library: Library) -> Iterator[CameraListing]:
    """Yield the cameras of a library except webcams, which V4L2 lists and drives better."""
    for camera in library.cameras:
        if origin_of(camera) != "webcam":
            properties = properties_of(camera)
            size = properties.get("PixelArraySize")
            sensor = f"sensor of {size.width}x{size.height}, " if size is not None else ""
            moved = any(control.name == "FrameDurationLimits" for control in camera.controls)
            yield CameraListing(
                spec=f"{KIND}:{camera.id}",
                kind=KIND,
                model=str(properties.get("Model", camera.id)),
                detail=f"{sensor}moved by {'frame durations' if moved else 'restarts'}",
            )
