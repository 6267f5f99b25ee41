"""One machine-vision camera through aravis: set up, its counter read, its frames fetched; all calls block.

Exposure and gain of a machine-vision camera, by GenICam's features.
"""

import contextlib
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from capture_app.camera_facts import MICROSECONDS, Control, ControlState, steps_of
from capture_app.cameras.aravis.library import camera_errors, load_aravis
from capture_app.cameras.aravis.machine_device import USABLE_FORMATS, DeviceFrame, DeviceSetup
from capture_app.cameras.specs import read_number, refuse_unknown
from capture_app.errors import CameraError


def read_controls(camera: Any, automatic_off: Any, setup: DeviceSetup) -> tuple[ControlState, ...]:
    """Those that the library's `camera` has; `automatic_off` is its word for a control that nobody moves."""
    found = []
    if camera.is_exposure_time_available():
        least_us, most_us = camera.get_exposure_time_bounds()
        found.append(
            ControlState(
                control=Control.EXPOSURE,
                value=camera.get_exposure_time(),
                unit=MICROSECONDS,
                automatic=is_automatic(camera, Control.EXPOSURE, automatic_off),
                can_be_automatic=camera.is_exposure_auto_available(),
                least=least_us,
                # A longer one would make frames late.
                most=min(most_us, setup.period_ns / 1000),
            )
        )
    if camera.is_gain_available():
        least, most = camera.get_gain_bounds()
        found.append(
            ControlState(
                control=Control.GAIN,
                value=camera.get_gain(),
                # Decibels with most, steps of the chip with some.
                unit=steps_of(setup.model),
                automatic=is_automatic(camera, Control.GAIN, automatic_off),
                can_be_automatic=camera.is_gain_auto_available(),
                least=least,
                most=most,
            )
        )
    return tuple(found)


def set_control(camera: Any, auto: Any, control: Control, value: float | None) -> None:
    """Set a control and hold it there; None: let the camera choose. `auto` has the library's words for that.

    Raises CameraError where the camera has no such control, the library's error where it refuses.
    """
    words = {
        Control.EXPOSURE: (
            camera.is_exposure_time_available,
            camera.is_exposure_auto_available,
            camera.set_exposure_time_auto,
            camera.set_exposure_time,
        ),
        Control.GAIN: (
            camera.is_gain_available,
            camera.is_gain_auto_available,
            camera.set_gain_auto,
            camera.set_gain,
        ),
    }
    is_there, can_choose, choose, set_value = words.get(control, (lambda: False,) * 4)
    if not is_there():
        raise CameraError(f"this camera has no control of its {control}")
    if value is not None:
        if can_choose():
            choose(auto.OFF)
        set_value(value)
    elif can_choose():
        choose(auto.CONTINUOUS)
    else:
        raise CameraError(f"this camera does not choose its {control} itself")


def is_automatic(camera: Any, control: Control, automatic_off: Any) -> bool:
    """Whether the camera chooses it, frame by frame."""
    if control is Control.EXPOSURE:
        return bool(camera.is_exposure_auto_available() and camera.get_exposure_time_auto() != automatic_off)
    return bool(camera.is_gain_auto_available() and camera.get_gain_auto() != automatic_off)


OPTIONS = {
    "width": "pixels of the picture, out of the middle of the sensor",
    "height": "the same",
    "fps": "frames a second (30)",
    "exposure_us": "exposure, else what the camera has set",
    "format": "pixel format by GenICam's name, such as Mono8 or BayerRG8",
    "row_us": "step that the camera rounds a frame's duration to, where it is coarser than a microsecond",
}
_RATES = ("AcquisitionFrameRate", "AcquisitionFrameRateAbs")
_LATCHES = (("TimestampLatch", "TimestampLatchValue"), ("GevTimestampControlLatch", "GevTimestampValue"))
"""Features that read the counter, in ns and in ticks: of SFNC 2 and of GigE Vision 1."""
_CONTROL, _HIGH, _LOW, _LATCH = 0x0944, 0x0948, 0x094C, 2
"""Registers of every GigE Vision device's bootstrap memory that do the same."""
_BUFFERED_NS, _BUFFER_BYTES, _BUFFER_COUNTS = 500_000_000, 256 << 20, (4, 64)
_SOCKET_BYTES = 8 << 20
_MARGIN_NS = 100
"""A duration that is this much longer is not cut to the step below."""


@dataclass(frozen=True, slots=True)
class DeviceRequest:
    """What a user asked for; None where the camera's own setting or the usual one will do."""

    width: int | None = None
    height: int | None = None
    fps: float | None = None
    exposure_us: float | None = None
    pixel_format: str | None = None
    row_ns: int | None = None


class AravisDevice:
    """A connected camera. Not thread-safe but for `next_frame`, which one other thread may call."""

    def __init__(self, address: str, request: DeviceRequest) -> None:
        """Connect and set up. Raises CameraError, BadInputError for what the camera does not offer."""
        self.address = address
        self._aravis = load_aravis()
        with camera_errors(address):
            self._camera = self._aravis.Camera.new(address)
            self._device = self._camera.get_device()
            self._rate = next((name for name in _RATES if self._camera.is_feature_available(name)), None)
            self.setup = self._set_up(request)
            self._stream = self._open_stream()

    def read_counter(self) -> tuple[int, int, int] | None:
        """Host time before, counter, host time after, in ns; None where there is no counter to read."""
        camera = self._camera
        with camera_errors(self.address):
            for latch, value in _LATCHES:
                if camera.is_feature_available(latch) and camera.is_feature_available(value):
                    sent_ns = time.monotonic_ns()
                    camera.execute_command(latch)
                    answered_ns = time.monotonic_ns()
                    ticks = camera.get_integer(value)
                    return sent_ns, self._from_ticks(ticks, value), answered_ns
            if not camera.is_gv_device():
                return None
            sent_ns = time.monotonic_ns()
            self._device.write_register(_CONTROL, _LATCH)
            answered_ns = time.monotonic_ns()
            ticks = self._device.read_register(_HIGH) << 32 | self._device.read_register(_LOW)
            return sent_ns, self._from_ticks(ticks, ""), answered_ns

    def controls(self) -> tuple[ControlState, ...]:
        """Exposure and gain as they stand. Raises CameraError."""
        with camera_errors(self.address):
            return read_controls(self._camera, self._aravis.Auto.OFF, self.setup)

    def set_control(self, control: Control, value: float | None) -> None:
        """Set a control and hold it there; None: let the camera choose. `setup` tells the exposure then."""
        with camera_errors(self.address):
            set_control(self._camera, self._aravis.Auto, control, value)
            exposure_ns, exposures_ns = self._exposure()
            self.setup = replace(self.setup, exposure_ns=exposure_ns, exposures_ns=exposures_ns)

    def set_period(self, period_ns: int) -> None:
        """Let frames last so long from now on. Raises CameraError."""
        with camera_errors(self.address):
            self._camera.set_float(self._rate, 1e9 / (period_ns + _MARGIN_NS))

    def start(self, on_lost: Any) -> None:
        """Let frames come; `on_lost` is called, on another thread, when the camera is not ours any more."""
        self._device.connect("control-lost", lambda _device: on_lost())
        with camera_errors(self.address):
            self._camera.start_acquisition()

    def next_frame(self, timeout_s: float) -> DeviceFrame | None:
        """Wait for a frame, for so long at most. The stream's thread only."""
        buffer = self._stream.timeout_pop_buffer(max(1, round(timeout_s * 1e6)))
        if buffer is None:
            return None
        whole = buffer.get_status() == self._aravis.BufferStatus.SUCCESS
        frame = DeviceFrame(
            number=buffer.get_frame_id(),
            counter_ns=buffer.get_timestamp(),
            arrival_ns=buffer.get_system_timestamp() - time.time_ns() + time.monotonic_ns(),
            data=bytes(buffer.get_data()) if whole else None,
        )
        self._stream.push_buffer(buffer)
        return frame

    def close(self) -> None:
        """Stop and let go of the camera; nothing of it may be used then."""
        with contextlib.suppress(CameraError), camera_errors(self.address):
            self._camera.stop_acquisition()
        # The library ends its threads and gives up the control with the last reference.
        del self._stream, self._device, self._camera

    def _set_up(self, request: DeviceRequest) -> DeviceSetup:
        camera = self._camera
        offered = camera.dup_available_pixel_formats_as_strings()
        wanted = request.pixel_format or camera.get_pixel_format_as_string()
        if request.pixel_format is None and wanted not in USABLE_FORMATS:
            wanted = next((name for name in USABLE_FORMATS if name in offered), wanted)
        if wanted not in offered or wanted not in USABLE_FORMATS:
            usable = ", ".join(name for name in offered if name in USABLE_FORMATS) or "none that can be saved"
            raise CameraError(f"{self.address} has no pixel format {wanted}", hint=f"it offers {usable}")
        camera.set_pixel_format_from_string(wanted)
        self._set_region(request)
        _x, _y, width, height = camera.get_region()
        model = f"{camera.get_vendor_name()} {camera.get_model_name()}"
        exposure_ns, exposures_ns = self._set_exposure(request.exposure_us)
        period_ns, durations_ns = self._set_rate(request.fps)
        return DeviceSetup(model, width, height, wanted, period_ns, durations_ns, exposure_ns, exposures_ns)

    def _set_region(self, request: DeviceRequest) -> None:
        camera = self._camera
        if request.width is None and request.height is None:
            return
        _x, _y, width, height = camera.get_region()
        width, height = request.width or width, request.height or height
        most = camera.get_sensor_size()
        (least_width, _), (least_height, _) = camera.get_width_bounds(), camera.get_height_bounds()
        if not (least_width <= width <= most[0] and least_height <= height <= most[1]):
            raise CameraError(
                f"{self.address} has no pictures of {width}x{height}", hint=f"at most {most[0]}x{most[1]}"
            )
        camera.set_region((most[0] - width) // 8 * 4, (most[1] - height) // 8 * 4, width, height)
        _x, _y, *taken = camera.get_region()
        if taken != [width, height]:
            raise CameraError(
                f"{self.address} makes {taken[0]}x{taken[1]} of {width}x{height}",
                hint="its sizes come in steps; ask for one of them",
            )

    def _set_exposure(self, exposure_us: float | None) -> tuple[int | None, tuple[int, int] | None]:
        camera = self._camera
        if exposure_us is not None:
            if not camera.is_exposure_time_available():
                raise CameraError(f"{self.address} has no control of its exposure")
            least_us, most_us = camera.get_exposure_time_bounds()
            if not least_us <= exposure_us <= most_us:
                raise CameraError(
                    f"{self.address} cannot expose for {exposure_us:g} us",
                    hint=f"from {least_us:g} to {most_us:g} us",
                )
            set_control(camera, self._aravis.Auto, Control.EXPOSURE, exposure_us)
        return self._exposure()

    def _exposure(self) -> tuple[int | None, tuple[int, int] | None]:
        """Exposure in ns, None where the camera chooses it, and its limits."""
        camera = self._camera
        if not camera.is_exposure_time_available():
            return None, None
        least_us, most_us = camera.get_exposure_time_bounds()
        limits_ns = round(least_us * 1000), round(most_us * 1000)
        if is_automatic(camera, Control.EXPOSURE, self._aravis.Auto.OFF):
            return None, limits_ns
        return round(camera.get_exposure_time() * 1000), limits_ns

    def _set_rate(self, fps: float | None) -> tuple[int, tuple[int, int] | None]:
        camera = self._camera
        if self._rate is None:
            raise CameraError(
                f"{self.address} has no frame rate that can be set",
                hint="such cameras are not supported yet; others can be triggered by a cable",
            )
        least, most = camera.get_frame_rate_bounds()
        rate = min(max(30.0, least), most) if fps is None else fps
        if not least <= rate <= most:
            raise CameraError(
                f"{self.address} does not run at {rate:g} frames a second", hint=f"from {least:g} to {most:g}"
            )
        period_ns = round(1e9 / rate)
        # Once by the library, which knows what vendors ask for before it; from then on by one write.
        camera.set_frame_rate(rate)
        self.set_period(period_ns)
        return period_ns, (round(1e9 / most), round(1e9 / max(least, 0.1)))

    def _open_stream(self) -> Any:
        camera, setup = self._camera, self.setup
        stream = camera.create_stream(None, None)
        if camera.is_gv_device():
            stream.set_property("socket-buffer", self._aravis.GvStreamSocketBuffer.FIXED)
            stream.set_property("socket-buffer-size", _SOCKET_BYTES)
        payload = camera.get_payload()
        least, most = _BUFFER_COUNTS
        count = max(least, min(most, _BUFFER_BYTES // payload, -(-_BUFFERED_NS // setup.period_ns)))
        for _ in range(count):
            stream.push_buffer(self._aravis.Buffer.new_allocate(payload))
        return stream

    def _from_ticks(self, ticks: int, feature: str) -> int:
        if feature == _LATCHES[0][1]:
            return ticks  # SFNC 2 has ns
        frequency = self._device.get_timestamp_tick_frequency() or 1_000_000_000
        return ticks * 1_000_000_000 // frequency


def parse_options(options: Mapping[str, str]) -> DeviceRequest:
    """Read a spec's options. Raises BadInputError, naming the wrong one."""
    refuse_unknown(options, OPTIONS, "a machine-vision camera")
    row_us = read_number(options, "row_us", "a camera", least=0.01, most=1000)
    width = read_number(options, "width", "a camera", least=1, most=1 << 16)
    height = read_number(options, "height", "a camera", least=1, most=1 << 16)
    return DeviceRequest(
        width=None if width is None else round(width),
        height=None if height is None else round(height),
        fps=read_number(options, "fps", "a camera", least=0.1, most=10_000),
        exposure_us=read_number(options, "exposure_us", "a camera", least=0.1, most=1e7),
        pixel_format=options.get("format"),
        row_ns=None if row_us is None else round(row_us * 1000),
    )
