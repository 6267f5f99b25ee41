"""One machine-vision camera through the system's aravis library: setup, counter readings, frames.

All calls block. The library is loaded on first use, and its errors become messages for users.
"""

import contextlib
import functools
import importlib
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from math import prod
from typing import TYPE_CHECKING, Any

from msgspec.structs import replace

from capture_app.cameras.base import buffer_count
from capture_app.cameras.frames import PixelPicture, every_nth
from capture_app.cameras.specs import CameraRequest
from capture_app.cameras.system_packages import load_system_module
from capture_app.common import system
from capture_app.common.camera_facts import (
    MICROSECONDS,
    CameraFacts,
    Control,
    ControlState,
    PhaseControl,
    TimestampSource,
    steps_of,
)
from capture_app.common.errors import CameraError, NotAvailableError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_CONVERSIONS = {
    "BayerRG": "COLOR_BayerRGGB2BGR",
    "BayerGR": "COLOR_BayerGRBG2BGR",
    "BayerGB": "COLOR_BayerGBRG2BGR",
    "BayerBG": "COLOR_BayerBGGR2BGR",
    "RGB": "COLOR_RGB2BGR",
}
"""OpenCV's conversions by GenICam's layouts; a Bayer pattern names the first two pixels of the first row."""
USABLE_FORMATS = (
    *(f"{layout}8" for layout in (*_CONVERSIONS, "BGR", "Mono")),
    *(f"{layout}{bits}" for layout in (*_CONVERSIONS, "Mono") for bits in (16, 12, 10) if layout != "RGB"),
)
"""Pixel formats that can be saved, best first; values of more than 8 bits take 16 bits each."""
PACKAGE = "gir1.2-aravis-0.8"
PURPOSE = "a GigE Vision or USB3 Vision camera"
_ERRORS: dict[int | None, tuple[str, str]] = {
    5: ("{} does not answer any more", "check its power and cable, then start it again"),
    6: (
        "there is no machine-vision camera {}",
        "`capture-app cameras` lists the cameras; one that is on has an address in this network",
    ),
    10: ("{} is in use by another program", "close it: only one can control a camera"),
}
"""Message and hint by the error code of the library's device errors."""
_CONTROLS = {
    Control.EXPOSURE: ("exposure_time", "is_exposure_auto_available"),
    Control.GAIN: ("gain", "is_gain_auto_available"),
}
"""A control's name in the library's methods, and the method that says whether it can be automatic."""
KIND = "aravis"
_RATES = ("AcquisitionFrameRate", "AcquisitionFrameRateAbs")
_LATCHES = (("TimestampLatch", "TimestampLatchValue"), ("GevTimestampControlLatch", "GevTimestampValue"))
"""Features that read the counter: SFNC 2 in ns, GigE Vision 1 in ticks."""
_CONTROL, _HIGH, _LOW, _LATCH = 0x0944, 0x0948, 0x094C, 2
"""Registers in the bootstrap memory of every GigE Vision device that read the counter."""


@dataclass(frozen=True, slots=True)
class DeviceFrame:
    """One frame as the library delivered it."""

    number: int
    """Frame number of the transport: 16 bits without 0, or wider."""
    counter_ns: int
    """Timestamp by the camera's own counter."""
    arrival_ns: int
    """Arrival of its first packet, in the host's monotonic clock."""
    data: bytes | None
    """None if packets are missing."""


def machine_picture(data: bytes, size: tuple[int, int], pixel_format: str) -> PixelPicture:
    """Return an image as the camera sent it; `size` is (width, height), `pixel_format` GenICam's name."""
    return PixelPicture(len(data), partial(_pixels, data, size, pixel_format))


def _pixels(
    data: bytes, size: tuple[int, int], pixel_format: str, min_width: int | None
) -> "NDArray[np.uint8]":
    """Return 8-bit pixels as in `PixelPicture.pixels`."""
    import cv2
    import numpy as np

    (width, height), (layout, bits) = size, split_format(pixel_format)
    shape = (height, width, 3) if layout in ("RGB", "BGR") else (height, width)
    pixels = np.frombuffer(data, "u1" if bits == 8 else "<u2", prod(shape)).reshape(shape)
    picture = pixels if bits == 8 else (pixels >> (bits - 8)).astype(np.uint8)
    if layout in _CONVERSIONS:
        picture = cv2.cvtColor(picture, getattr(cv2, _CONVERSIONS[layout]))
    return every_nth(np.asarray(picture, np.uint8), min_width)


def split_format(pixel_format: str) -> tuple[str, int]:
    """Split a usable format's name into layout and bits, such as BayerRG and 12."""
    layout = pixel_format.rstrip("0123456789")
    return layout, int(pixel_format[len(layout) :])


@functools.cache
def load_aravis() -> Any:
    """Return the library's module. Raises NotAvailableError if it is not installed or does not load."""
    gi = load_system_module("gi", PACKAGE, PURPOSE)
    try:
        gi.require_version("Aravis", "0.8")
        with warnings.catch_warnings():
            # PyGObject's importer uses an older import API than the newest Python.
            warnings.simplefilter("ignore", ImportWarning)
            importlib.import_module("gi.repository.GLib")
            return importlib.import_module("gi.repository.Aravis")
    except (ImportError, ValueError) as error:
        raise NotAvailableError(
            f"{PURPOSE} needs the aravis library, which is not installed",
            hint=f"on Debian and Raspberry Pi OS: sudo apt install {PACKAGE}",
        ) from error


@contextmanager
def camera_errors(device: str) -> Iterator[None]:
    """Convert the library's errors to CameraError while a device is used."""
    library_error = importlib.import_module("gi.repository.GLib").Error
    try:
        yield
    except library_error as error:
        code = error.code if error.domain == "arv-device-error-quark" else None
        what, hint = _ERRORS.get(code, ("{} failed: {}", "another program, such as arv-viewer, may say more"))
        raise CameraError(what.format(device, error.message), hint=hint) from error


class AravisDevice:
    """A connected camera. Not thread-safe except `next_frame`, which one other thread may call."""

    def __init__(self, address: str, request: CameraRequest) -> None:
        """Connect and set up. Raises CameraError, BadInputError for settings that it does not offer."""
        self.address = address
        self._aravis = load_aravis()
        with camera_errors(address):
            self._camera = self._aravis.Camera.new(address)
            self._device = self._camera.get_device()
            self._rate = next((name for name in _RATES if self._camera.is_feature_available(name)), None)
            self.facts = self._set_up(request)
            self._stream = self._open_stream()

    def read_counter(self) -> tuple[int, int, int] | None:
        """Return host time before, counter, host time after, in ns; None without a readable counter."""
        camera = self._camera
        with camera_errors(self.address):
            latch, value = next(
                (pair for pair in _LATCHES if all(map(camera.is_feature_available, pair))), ("", "")
            )
            if not latch and not camera.is_gv_device():
                return None
            sent_ns = system.monotonic_ns()
            if latch:
                camera.execute_command(latch)
            else:
                self._device.write_register(_CONTROL, _LATCH)
            answered_ns = system.monotonic_ns()
            read = self._device.read_register
            ticks = camera.get_integer(value) if latch else read(_HIGH) << 32 | read(_LOW)
            is_in_ns = latch == _LATCHES[0][0]
            frequency = 0 if is_in_ns else self._device.get_timestamp_tick_frequency()
        return sent_ns, ticks * 1_000_000_000 // (frequency or 1_000_000_000), answered_ns

    def controls(self) -> tuple[ControlState, ...]:
        """Return the current exposure and gain. Raises CameraError."""
        with camera_errors(self.address):
            states = [state for control in _CONTROLS if (state := self._state(control))]
        # A longer exposure than a period would delay frames.
        period_us = self.facts.period_ns / 1000
        return tuple(
            replace(state, maximum=state.clamped(period_us)) if state.control is Control.EXPOSURE else state
            for state in states
        )

    def set_control(self, control: Control, value: float | None) -> None:
        """Set a control to a fixed value; None lets the camera choose. Updates the exposure in `facts`."""
        with camera_errors(self.address):
            self._set(control, value)
            self.facts = replace(self.facts, **self._exposure())

    def set_period(self, period_ns: int) -> None:
        """Set the frame duration (ns) of all following frames. Raises CameraError."""
        with camera_errors(self.address):
            # A little longer, so that it is not rounded down to the step below.
            self._camera.set_float(self._rate, 1e9 / (period_ns + 100))

    def start(self, on_lost: Any) -> None:
        """Start streaming; `on_lost` is called, on another thread, when the control of the camera is lost."""
        self._device.connect("control-lost", lambda _device: on_lost())
        with camera_errors(self.address):
            self._camera.start_acquisition()

    def next_frame(self, timeout_s: float) -> DeviceFrame | None:
        """Wait up to `timeout_s` for a frame. Only the stream's thread may call it."""
        buffer = self._stream.timeout_pop_buffer(max(1, round(timeout_s * 1e6)))
        if buffer is None:
            return None
        is_whole = buffer.get_status() == self._aravis.BufferStatus.SUCCESS
        frame = DeviceFrame(
            number=buffer.get_frame_id(),
            counter_ns=buffer.get_timestamp(),
            arrival_ns=buffer.get_system_timestamp() - time.time_ns() + system.monotonic_ns(),
            data=bytes(buffer.get_data()) if is_whole else None,
        )
        self._stream.push_buffer(buffer)
        return frame

    def close(self) -> None:
        """Stop and release the camera; it cannot be used afterwards."""
        with contextlib.suppress(CameraError), camera_errors(self.address):
            self._camera.stop_acquisition()
        # The library ends its threads and releases control with the last reference.
        del self._stream, self._device, self._camera

    def _set_up(self, request: CameraRequest) -> CameraFacts:
        camera = self._camera
        offered = camera.dup_available_pixel_formats_as_strings()
        pixel_format = request.format or camera.get_pixel_format_as_string()
        if request.format is None and pixel_format not in USABLE_FORMATS:
            pixel_format = next((name for name in USABLE_FORMATS if name in offered), pixel_format)
        if pixel_format not in offered or pixel_format not in USABLE_FORMATS:
            usable = ", ".join(name for name in offered if name in USABLE_FORMATS) or "none that can be saved"
            raise CameraError(
                f"{self.address} has no pixel format {pixel_format}", hint=f"it offers {usable}"
            )
        camera.set_pixel_format_from_string(pixel_format)
        self._set_region(request)
        _x, _y, width, height = camera.get_region()
        self._set_exposure(request.exposure_us)
        exposure = self._exposure()
        period_ns, shortest_ns, longest_ns = self._set_rate(request.fps)
        facts = CameraFacts(
            kind=KIND,
            model=f"{camera.get_vendor_name()} {camera.get_model_name()}"[:200],
            width=width,
            height=height,
            pixel_format=pixel_format,
            period_ns=period_ns,
            timestamp_source=TimestampSource.UNKNOWN,
            phase_control=PhaseControl.FRAME_DURATION,
            row_time_ns=None if request.row_us is None else round(request.row_us * 1000),
            min_frame_duration_ns=shortest_ns,
            max_frame_duration_ns=longest_ns,
        )
        return replace(facts, **exposure)

    def _set_region(self, request: CameraRequest) -> None:
        camera = self._camera
        if request.width is None and request.height is None:
            return
        _x, _y, width, height = camera.get_region()
        width, height = request.width or width, request.height or height
        max_size = camera.get_sensor_size()
        (min_width, _), (min_height, _) = camera.get_width_bounds(), camera.get_height_bounds()
        if not (min_width <= width <= max_size[0] and min_height <= height <= max_size[1]):
            raise CameraError(
                f"{self.address} has no pictures of {width}x{height}",
                hint=f"ask for at most {max_size[0]}x{max_size[1]}",
            )
        camera.set_region((max_size[0] - width) // 8 * 4, (max_size[1] - height) // 8 * 4, width, height)
        _x, _y, *taken = camera.get_region()
        if taken != [width, height]:
            raise CameraError(
                f"{self.address} makes {taken[0]}x{taken[1]} of {width}x{height}",
                hint="its sizes come in steps; ask for one of them",
            )

    def _set_exposure(self, exposure_us: float | None) -> None:
        if exposure_us is None:
            return
        state = self._state(Control.EXPOSURE)
        if state is None:
            raise CameraError(f"{self.address} has no control of its exposure", hint="leave out exposure_us")
        if state.clamped(exposure_us) != exposure_us:
            raise CameraError(
                f"{self.address} cannot expose for {exposure_us:g} us",
                hint=f"give exposure_us= from {state.minimum:g} to {state.maximum:g}",
            )
        self._set(Control.EXPOSURE, exposure_us)

    def _exposure(self) -> dict[str, int | None]:
        """Return the facts of the exposure in ns; the exposure itself is None if the camera chooses it."""
        state = self._state(Control.EXPOSURE)
        if state is None:
            return {}
        exposure_us = None if state.automatic else state.value
        facts_us = {"exposure": exposure_us, "min_exposure": state.minimum, "max_exposure": state.maximum}
        return {f"{name}_ns": None if us is None else round(us * 1000) for name, us in facts_us.items()}

    def _state(self, control: Control) -> ControlState | None:
        """Return a control in the form that all cameras share; None if this one does not have it."""
        name, has_switch = _CONTROLS[control]
        if not self._call(f"is_{name}_available"):
            return None
        can_be_automatic = bool(self._call(has_switch))
        lowest, highest = self._call(f"get_{name}_bounds")
        return ControlState(
            control=control,
            value=float(self._call(f"get_{name}")),
            # Gain is in decibels on most cameras, in steps of the chip on some.
            unit=MICROSECONDS if control is Control.EXPOSURE else steps_of(self.facts.model),
            automatic=can_be_automatic and self._call(f"get_{name}_auto") != self._aravis.Auto.OFF,
            can_be_automatic=can_be_automatic,
            minimum=lowest,
            maximum=highest,
        )

    def _set(self, control: Control, value: float | None) -> None:
        (name, has_switch), auto = _CONTROLS[control], self._aravis.Auto
        if self._call(has_switch):
            self._call(f"set_{name}_auto", auto.CONTINUOUS if value is None else auto.OFF)
        if value is not None:
            self._call(f"set_{name}", value)

    def _call(self, method: str, *values: Any) -> Any:
        return getattr(self._camera, method)(*values)

    def _set_rate(self, fps: float | None) -> tuple[int, int, int]:
        """Set the frame rate; return the frame period and its min and max, in ns."""
        camera = self._camera
        if self._rate is None:
            raise CameraError(
                f"{self.address} has no frame rate that can be set",
                hint="use a camera with the feature AcquisitionFrameRate",
            )
        min_fps, max_fps = camera.get_frame_rate_bounds()
        rate = min(max(30.0, min_fps), max_fps) if fps is None else fps
        if not min_fps <= rate <= max_fps:
            raise CameraError(
                f"{self.address} does not run at {rate:g} frames a second",
                hint=f"give fps= from {min_fps:g} to {max_fps:g}",
            )
        period_ns = round(1e9 / rate)
        # First through the library, which sets what vendors require before it; later by a single write.
        camera.set_frame_rate(rate)
        self.set_period(period_ns)
        return period_ns, round(1e9 / max_fps), round(1e9 / max(min_fps, 0.1))

    def _open_stream(self) -> Any:
        camera = self._camera
        stream = camera.create_stream(None, None)
        if camera.is_gv_device():
            stream.set_property("socket-buffer", self._aravis.GvStreamSocketBuffer.FIXED)
            stream.set_property("socket-buffer-size", 8 << 20)
        payload = camera.get_payload()
        for _ in range(buffer_count(payload, self.facts.period_ns, max_count=64, max_bytes=256 << 20)):
            stream.push_buffer(self._aravis.Buffer.new_allocate(payload))
        return stream
