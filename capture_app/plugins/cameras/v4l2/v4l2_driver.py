"""USB webcams and other Video4Linux2 cameras: listed, opened, streamed, controlled and restarted.

Timestamps are the driver's own, in CLOCK_MONOTONIC of the host, and are stored unchanged. The camera's facts
say which moment of a frame they mark and their delay: uvcvideo claims the start of the exposure, but stamps
the arrival of a frame's first bytes. Exposure, gain, white balance and focus are the kernel's standard
controls.
"""

import asyncio
import errno
import logging
import mmap
import os
import stat
import time
from collections.abc import Iterator, Mapping
from contextlib import closing, suppress
from pathlib import Path

from msgspec import structs

from capture_app.cameras.base import (
    Camera,
    OnFailure,
    OnFrame,
    SwitchedControl,
    ThreadedCamera,
    buffer_count,
    wait_for_start,
)
from capture_app.cameras.frame_reader import FrameReader
from capture_app.cameras.frames import CapturedFrame, PixelFormat, picture_from_buffer
from capture_app.common import system
from capture_app.common.camera_facts import (
    KELVIN,
    MICROSECONDS,
    CameraFacts,
    CameraListing,
    Control,
    ControlState,
    PhaseControl,
    StampSource,
    TimestampSource,
    steps_of,
)
from capture_app.common.clock import NodeClock
from capture_app.common.errors import CameraError
from capture_app.plugins.cameras.v4l2 import kernel as v4l2
from capture_app.plugins.cameras.v4l2.kernel import VideoDevice, driver_error
from capture_app.plugins.cameras.v4l2.modes import check_capture, configure, offered_modes, parse_options
from capture_app.sync.wire.camera_commands import CameraCommand, RestartStream

_UNIT_NS = 100_000
"""Step of the exposure control."""
_SOURCES = {
    v4l2.BUF_FLAG_SOURCE_START_OF_EXPOSURE: TimestampSource.START_OF_EXPOSURE,
    v4l2.BUF_FLAG_SOURCE_END_OF_FRAME: TimestampSource.END_OF_FRAME,
}
SPEC = "v4l2:/dev/videoN[,key=value…]"
HELP = "USB webcams and other Video4Linux cameras of Linux."
NEEDS = ""
OPTIONS = {
    "width": "pixels of the picture",
    "height": "the same",
    "fps": "frames a second",
    "format": "pixel format, such as MJPG, YUYV or GREY",
}
VIDEO4LINUX_MAJOR = 81
"""Linux's major number of Video4Linux device nodes."""
WAKING_TRIES = 5
WAKING_PAUSE_S = 0.1


def read_exposure(device: VideoDevice) -> tuple[int | None, float | None]:
    """Return exposure in ns and gain in the device's unit; None if the camera chooses them frame by frame."""
    if device.control("EXPOSURE_AUTO") not in (None, v4l2.EXPOSURE_MANUAL):
        return None, None
    exposure, gain = device.control("EXPOSURE_ABSOLUTE"), device.control("GAIN")
    return (
        None if exposure is None else exposure * _UNIT_NS,
        None if gain is None or device.control("AUTOGAIN") else float(gain),
    )


_CONTROLS = {
    Control.EXPOSURE: SwitchedControl(
        "EXPOSURE_ABSOLUTE",
        MICROSECONDS,
        "EXPOSURE_AUTO",
        manual=v4l2.EXPOSURE_MANUAL,
        # Webcams cannot move the aperture and call this "aperture priority"; other cameras call it automatic.
        automatic=(v4l2.EXPOSURE_APERTURE_PRIORITY, v4l2.EXPOSURE_AUTO),
        scale=_UNIT_NS / 1000,
    ),
    Control.GAIN: SwitchedControl("GAIN", None, "AUTOGAIN"),
    Control.WHITE_BALANCE: SwitchedControl("WHITE_BALANCE_K", KELVIN, "AUTO_WHITE_BALANCE"),
    Control.FOCUS: SwitchedControl("FOCUS_ABSOLUTE", None, "FOCUS_AUTO"),
}


def read_controls(device: VideoDevice, model: str) -> tuple[ControlState, ...]:
    """Return the controls that the device has."""
    states = []
    for control, settings in _CONTROLS.items():
        if (limits := device.control_range(settings.value)) is not None:
            switch, value = device.control(settings.switch), device.control(settings.value)
            states.append(
                ControlState(
                    control=control,
                    value=None if value is None else value * settings.scale,
                    unit=settings.unit or steps_of(model),
                    automatic=switch not in (None, settings.manual),
                    can_be_automatic=switch is not None,
                    minimum=limits[0] * settings.scale,
                    maximum=limits[1] * settings.scale,
                )
            )
    return tuple(states)


def set_control(device: VideoDevice, control: Control, value: float | None) -> None:
    """Set a control in its unit to a fixed value; None lets the camera choose. Raises OSError."""
    settings = _CONTROLS[control]
    switch = device.control(settings.switch)
    *preferred, last = settings.automatic if value is None else (settings.manual,)
    if switch not in (None, *preferred, last):
        for choice in preferred:
            with suppress(OSError):
                device.set_control(settings.switch, choice)
                break
        else:
            device.set_control(settings.switch, last)
    if value is not None:
        device.set_control(settings.value, round(value / settings.scale))


_log = logging.getLogger(__name__)


class V4L2Camera(ThreadedCamera):
    """A V4L2 camera that streams into mapped buffers; `driver.open_camera` creates one."""

    def __init__(self, device: VideoDevice, layout: PixelFormat, period_ns: int) -> None:
        """Take over a configured device. Raises OSError, CameraError for an unusable clock."""
        super().__init__("v4l2")
        self._device, self._layout = device, layout
        self._command_lock = asyncio.Lock()
        self._streaming = False
        self._stream = 0
        max_buffers = buffer_count(layout.buffer_bytes, period_ns, max_count=32, max_bytes=128 << 20)
        buffers = [device.query_buffer(index) for index in range(device.request_buffers(max_buffers))]
        self._memory: list[mmap.mmap] = [device.map(buffer) for buffer in buffers]
        limits, flags = device.control_range("EXPOSURE_ABSOLUTE"), buffers[0].flags
        if flags & v4l2.BUF_FLAG_TIMESTAMP_MASK != v4l2.BUF_FLAG_TIMESTAMP_MONOTONIC:
            raise _foreign_clock(device.path)
        driver, model, _ = device.capability()
        self._is_uvc = driver == "uvcvideo"
        self._facts = CameraFacts(
            kind="v4l2",
            model=model,
            width=layout.width,
            height=layout.height,
            pixel_format=layout.fourcc,
            period_ns=period_ns,
            timestamp_source=_SOURCES.get(flags & v4l2.BUF_FLAG_SOURCE_MASK, TimestampSource.UNKNOWN),
            phase_control=PhaseControl.RESET,
            min_exposure_ns=limits[0] * _UNIT_NS if limits else None,
            max_exposure_ns=limits[1] * _UNIT_NS if limits else None,
        )
        self._update_exposure()
        self._auto_priority = device.control("EXPOSURE_AUTO_PRIORITY")
        """Original value, restored at release; 0 meanwhile, so that no frame lasts longer in the dark."""
        self._set_auto_priority(0)

    async def start(self, on_frame: OnFrame, on_failure: OnFailure) -> None:
        """Start streaming. Raises CameraError if the device is missing, busy, or out of USB bandwidth."""
        self.listen(on_frame, on_failure)
        async with self._command_lock:
            try:
                await self._in_worker(self._begin_stream)
            except OSError as error:
                raise driver_error(self._device.path, error) from error
            if not self._closing.is_set():
                self._streaming = True
                self._listen()

    async def apply(self, command: CameraCommand) -> None:
        """Restart the stream; the delay counts from this call.

        If stopping takes longer than the delay, whole frame periods are added, so that the start keeps its
        phase. A device that disconnects meanwhile is reported through `on_failure`.
        Raises CameraError for any other command, or without a stream.
        """
        asked_ns = system.monotonic_ns()
        if not isinstance(command, RestartStream):
            raise CameraError(
                f"{self._device.path} cannot change the length of single frames",
                hint="restart its stream instead",
            )
        async with self._command_lock:
            if not self._streaming:
                raise CameraError(f"{self._device.path} does not stream")
            self._reader.stop()
            try:
                await self._in_worker(self._begin_stream, asked_ns + command.delay_ns)
            except OSError as error:
                self._fail(driver_error(self._device.path, error))
            if self._streaming:
                self._listen()

    async def _let_go(self) -> None:
        self._end_stream()
        await self._in_worker(self._release)

    def _end_stream(self) -> bool:
        """Read no more; return whether it had read."""
        if was_streaming := self._streaming:
            self._streaming = False
            self._reader.stop()
        return was_streaming

    async def controls(self) -> tuple[ControlState, ...]:
        """Return the device's controls with their current values; empty after it was stopped."""
        is_open = not self._closing.is_set()
        return await self._in_worker(read_controls, self._device, self.facts.model) if is_open else ()

    async def set_control(self, control: Control, value: float | None) -> None:
        """Set a control, or let the camera choose it. Raises CameraError if it cannot be set."""
        if self._closing.is_set():
            raise CameraError(
                f"{self._device.path} was stopped", hint="capture-app status shows when it runs again"
            )
        try:
            await self._in_worker(self._set_control, control, value)
        except OSError as error:
            raise driver_error(self._device.path, error) from error

    def _set_control(self, control: Control, value: float | None) -> None:
        set_control(self._device, control, value)
        self._update_exposure()

    def _update_exposure(self) -> None:
        """Update the exposure in facts and frames; uvcvideo's timestamps are late by it."""
        self._exposure_ns, self._gain = read_exposure(self._device)
        facts = structs.replace(self.facts, exposure_ns=self._exposure_ns)
        late = structs.replace(facts.assumed_stamp, source=StampSource.PROFILE)
        self._facts = structs.replace(facts, stamp=late) if self._is_uvc else facts

    def _release(self) -> None:
        if self._stream:
            self._reader.join()
        with suppress(OSError):
            self._device.stream_off()
        for memory in self._memory:
            memory.close()
        self._memory = []
        self._set_auto_priority(self._auto_priority or 0)
        self._device.close()

    def _set_auto_priority(self, value: int) -> None:
        if self._auto_priority:
            with suppress(OSError):
                self._device.set_control("EXPOSURE_AUTO_PRIORITY", value)

    def _begin_stream(self, start_ns: int | None = None) -> None:
        """Start in the worker; with `start_ns` of the monotonic clock, stop first, and start then.

        It is one call, so that a concurrent stop releases the device after all steps, not between them.
        """
        if start_ns is not None:
            self._reader.join()
            self._device.stream_off()
        self._exposure_ns, self._gain = read_exposure(self._device)
        for index in range(len(self._memory)):
            self._device.queue(index)
        if start_ns is None or wait_for_start(
            start_ns - system.monotonic_ns(), self.facts.period_ns, self._closing
        ):
            self._device.stream_on()

    def _listen(self) -> None:
        self._stream += 1
        self._clock_checked = False
        self._reader = FrameReader(
            self._filled,
            self._take,
            lambda error: self._fail(driver_error(self._device.path, error)),
            period_ns=self.facts.period_ns,
            buffers=len(self._memory),
        )

    def _filled(self) -> Iterator[tuple[v4l2.Buffer, bytes]]:
        """Yield what is in the driver's filled buffers, at most as many as there are. Raises OSError."""
        for _ in self._memory:
            try:
                buffer = self._device.dequeue()
            except BlockingIOError:
                return
            data = self._memory[buffer.index][: buffer.bytes_used]
            self._device.queue(buffer.index)
            yield buffer, data

    def _take(self, filled: tuple[v4l2.Buffer, bytes]) -> None:
        buffer, data = filled
        picture = None if buffer.flags & v4l2.BUF_FLAG_ERROR else picture_from_buffer(data, self._layout)
        if picture is None:
            # Its sequence number is missing from the stream, as with any dropped frame.
            _log.debug("%s: frame %d came damaged", self._device.path, buffer.sequence)
            return
        if not self._clock_checked:
            # A stamp a minute from its frame's arrival is not in this process's monotonic clock.
            if abs(buffer.timestamp_ns - system.monotonic_ns()) > 60_000_000_000:
                self._fail(_foreign_clock(self._device.path))
                return
            self._clock_checked = True
        self._on_frame(
            CapturedFrame(
                sequence=buffer.sequence,
                stream=self._stream,
                timestamp_ns=buffer.timestamp_ns,
                picture=picture,
                exposure_ns=self._exposure_ns,
                gain=self._gain,
            )
        )

    def _fail(self, error: CameraError) -> None:
        if self._end_stream():
            self._on_failure(error)


def _foreign_clock(path: str) -> CameraError:
    return CameraError(
        f"{path} does not stamp its frames in this machine's monotonic clock",
        hint="for a USB camera: echo CLOCK_MONOTONIC | sudo tee /sys/module/uvcvideo/parameters/clock",
    )


def open_camera(path: str, options: Mapping[str, str], *, clock: NodeClock, name: str) -> Camera:
    """Open a camera by its device node; see OPTIONS.

    Raises BadInputError for an option that cannot be read; CameraError if the device is missing, not a
    camera, busy, not permitted, without the requested mode, or stamps frames in another clock;
    NotAvailableError on a 32-bit system. May take half a second if the camera sleeps.
    """
    request = parse_options(options)
    try:
        device = open_video_node(path)
        try:
            _, model, flags = device.capability()
            check_capture(path, model, flags)
            layout, period = configure(device, request)
            return V4L2Camera(device, layout, round(period * 1_000_000_000)).in_clock(clock)
        except BaseException:
            device.close()
            raise
    except OSError as error:
        raise driver_error(path, error) from error


def open_video_node(path: str) -> VideoDevice:
    """Open a node after checking that it is a Video4Linux node: opening others may have side effects.

    Raises CameraError for another kind of node, OSError from the driver.
    """
    v4l2.check_layout()
    status = Path(path).stat()
    if not (stat.S_ISCHR(status.st_mode) and os.major(status.st_rdev) == VIDEO4LINUX_MAJOR):
        raise CameraError(f"{path} is not a camera", hint="`capture-app cameras` lists the cameras")
    for _ in range(WAKING_TRIES - 1):
        try:
            return VideoDevice(path)
        except OSError as error:
            if error.errno != errno.EBUSY:
                raise
            # A sleeping USB camera answers so while its hub wakes up; uvcvideo never means "in use" here.
            time.sleep(WAKING_PAUSE_S)
    return VideoDevice(path)


def list_cameras(folder: Path = Path("/dev")) -> list[CameraListing]:
    """Return the V4L2 cameras of this machine in the order of their numbers, including unusable ones."""
    nodes = {int(node.name[5:]): node for node in folder.glob("video*") if node.name[5:].isdecimal()}
    return [listing for _, node in sorted(nodes.items()) for listing in _listings(node)]


def _listings(node: Path) -> Iterator[CameraListing]:
    """Yield the listing of one node; nothing if it delivers no images."""
    spec = f"v4l2:{node}"
    try:
        with closing(open_video_node(str(node))) as device:
            _, model, flags = device.capability()
            check_capture(str(node), model, flags)
            yield CameraListing(spec, "v4l2", model, ", ".join(map(str, offered_modes(device))))
    except CameraError:
        return
    except OSError as error:
        name = Path("/sys/class/video4linux", node.name, "name")
        card = name.read_text(encoding="utf-8").strip() if name.is_file() else ""
        yield CameraListing(spec, "v4l2", card, str(driver_error(str(node), error)), usable=False)
