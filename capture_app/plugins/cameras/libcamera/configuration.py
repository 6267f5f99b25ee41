"""Configuration of a libcamera camera from a user's request, its facts as they become known, its controls."""

import dataclasses
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

from msgspec.structs import replace

from capture_app.cameras.base import SwitchedControl
from capture_app.cameras.frames import PixelFormat
from capture_app.cameras.specs import CameraRequest, read_request
from capture_app.common.camera_facts import (
    DIOPTRES,
    KELVIN,
    MICROSECONDS,
    TIMES,
    CameraFacts,
    Control,
    ControlState,
    PhaseControl,
    StampAccuracy,
    StampSource,
    TimestampSource,
)
from capture_app.common.errors import BadInputError, CameraError

FOURCC = {"MJPEG": "MJPG", "NV12": "NV12", "YUYV": "YUYV", "R8": "GREY"}
"""The library's formats that can be saved, best first, with their V4L2 names."""
BUFFERS = 6
"""A process can be delayed by this many frames without a loss; a command takes effect after as many."""
KIND = "libcamera"
CHARACTER_DEVICES = Path("/sys/dev/char")
READOUT_UNCERTAINTY_ROWS, READOUT_UNCERTAINTY_NS = 16, 100_000
"""Assumed: rows that a sensor sends before the image's first, and the delay from stamp to kernel."""
_TYPICAL_RATE, _ROUND_NS = 3e-4, 10_000


KnownControls = Mapping[str, tuple[Any, Any]]
"""Controls that a camera accepts in requests, with their limits, by name; libraries differ in which."""


def first_exposure(controls: KnownControls, wishes: CameraRequest) -> dict[str, Any]:
    """Return the exposure and gain that a stream starts with; empty where nothing was requested."""
    asked = {"ExposureTime": wishes.exposure_us, "AnalogueGain": wishes.gain}
    fixed = {name: value for name, value in asked.items() if value is not None}
    # With only one of the two set, the other stays automatic until both are fixed.
    all_fixed = fixed and all(name in fixed for name in asked if name in controls)
    return {"AeEnable": False, **fixed} if all_fixed else fixed


def held_exposure(metadata: Mapping[str, Any], wishes: CameraRequest) -> dict[str, Any]:
    """Return settings that fix exposure, gain and white balance at a frame's values or at requested ones."""
    colours = metadata.get("ColourGains")
    held = {
        "AeEnable": False,
        "ExposureTime": wishes.exposure_us or metadata.get("ExposureTime"),
        "AnalogueGain": wishes.gain or metadata.get("AnalogueGain"),
        "AwbEnable": False if colours else None,
        "ColourGains": tuple(colours) if colours else None,
    }
    return {name: value for name, value in held.items() if value is not None}


_AE, _AWB = ("AeEnable", False, (True,)), ("AwbEnable", False, (True,))
"""Switches of automatic exposure and white balance, with their values for manual and automatic."""
_CONTROLS = {
    Control.EXPOSURE: SwitchedControl("ExposureTime", MICROSECONDS, *_AE, together=("AnalogueGain",)),
    Control.GAIN: SwitchedControl("AnalogueGain", TIMES, *_AE, together=("ExposureTime",)),
    Control.WHITE_BALANCE: SwitchedControl("ColourTemperature", KELVIN, *_AWB, together=("ColourGains",)),
    Control.FOCUS: SwitchedControl("LensPosition", DIOPTRES, "AfMode", automatic=(2,)),
}


def read_states(
    known: KnownControls, settings: Mapping[str, Any], metadata: Mapping[str, Any], period_us: int
) -> Iterator[ControlState]:
    """Yield the controls' state from the settings and the last frame; the period limits the exposure."""
    for control, of in _CONTROLS.items():
        if of.value in known:
            _, limits = known[of.value]
            value = metadata.get(of.value, settings.get(of.value))
            yield ControlState(
                control=control,
                value=None if value is None else float(value),
                unit=of.unit or "",
                automatic=of.switch in known and settings.get(of.switch, of.automatic[0]) in of.automatic,
                can_be_automatic=of.switch in known,
                minimum=float(limits.min),
                maximum=float(min(limits.max, period_us) if control is Control.EXPOSURE else limits.max),
            )


def new_settings(
    control: Control, value: float | None, metadata: Mapping[str, Any]
) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Return settings for a control in its unit, None for automatic; and names of settings to drop."""
    of = _CONTROLS[control]
    if value is None:
        return {of.switch: of.automatic[0]}, (of.value, *of.together)
    number = round(value) if control in (Control.EXPOSURE, Control.WHITE_BALANCE) else float(value)
    settings = {of.switch: of.manual, of.value: number}
    if of.switch != "AeEnable":
        return settings, of.together
    # Exposure and gain share their switch: setting one fixes the other at its current value.
    return {**{name: metadata[name] for name in of.together if name in metadata}, **settings}, ()


def parse_options(options: Mapping[str, str]) -> CameraRequest:
    """Read width, height, fps, format, exposure_us and gain. Raises BadInputError naming the wrong one."""
    asked = read_request(options, "a camera of libcamera")
    fourcc = asked.format and FOURCC.get(asked.format.upper(), asked.format.upper())
    if fourcc not in (None, *FOURCC.values()):
        raise BadInputError(
            f"format={asked.format} cannot be saved", hint=f"there are {', '.join(FOURCC.values())}"
        )
    whole_us = None if asked.exposure_us is None else max(1, round(asked.exposure_us))
    return dataclasses.replace(asked, format=fourcc, exposure_us=whole_us)


def configure(module: Any, camera: Any, wishes: CameraRequest) -> tuple[Any, PixelFormat]:
    """Configure an acquired camera; return its stream and the memory layout of its images.

    Raises CameraError, which lists what the camera offers, if it has no such mode.
    """
    name = camera.id
    configuration = camera.generate_configuration([module.StreamRole.VideoRecording])
    if configuration is None or configuration.size == 0:
        raise CameraError(f"{name} delivers no video", hint="`capture-app cameras` lists the cameras")
    stream = configuration.at(0)
    offered = [str(pixel_format) for pixel_format in stream.formats.pixel_formats]
    formats = [code for code in FOURCC if code in offered and wishes.format in (None, FOURCC[code])]
    if not formats:
        raise CameraError(
            f"{name} does not offer {wishes.format or 'a format that can be saved'}",
            hint=f"it offers {', '.join(offered)}",
        )
    stream.pixel_format = module.PixelFormat(formats[0])
    stream.size = module.Size(*wishes.size)
    stream.buffer_count = max(stream.buffer_count, BUFFERS)
    if configuration.validate() == module.CameraConfiguration.Status.Invalid:
        raise CameraError(
            f"{name} has no mode {formats[0]} {_text(wishes.size)}", hint="leave out width, height and format"
        )
    width, height = stream.size.width, stream.size.height
    if wishes.width not in (None, width) or wishes.height not in (None, height):
        raise CameraError(
            f"{name} has no mode {formats[0]} {_text(wishes.size)}",
            hint=f"the nearest is width={width},height={height}",
        )
    if str(stream.pixel_format) not in FOURCC:
        raise CameraError(
            f"{name} does not offer {formats[0]} in {_text((width, height))}",
            hint="leave out width and height",
        )
    camera.configure(configuration)
    fourcc = FOURCC[str(stream.pixel_format)]
    return stream, PixelFormat(fourcc, width, height, stream.stride, stream.frame_size)


def _text(size: tuple[int, int]) -> str:
    return f"{size[0]}x{size[1]}"


Origin = Literal["raspberry-pi", "webcam", "other"]
"""Pipeline that drives a camera, as far as it determines what its timestamps mark."""


def origin_of(camera: Any) -> Origin:
    """Return the kind of pipeline that drives a camera of the library."""
    # Only the Raspberry Pi's pipelines have controls of this vendor.
    if any(control.vendor == "rpi" for control in camera.controls):
        return "raspberry-pi"
    nodes = (
        CHARACTER_DEVICES / f"{os.major(device)}:{os.minor(device)}"
        for device in properties_of(camera).get("SystemDevices", ())
    )
    is_webcam = any((node / "device" / "driver").resolve().name == "uvcvideo" for node in nodes)
    return "webcam" if is_webcam else "other"


def properties_of(camera: Any) -> dict[str, Any]:
    """Return a camera's properties by name."""
    return {control.name: value for control, value in camera.properties.items()}


def facts_as_configured(
    camera: Any, layout: PixelFormat, wishes: CameraRequest, limits_us: tuple[int, int] | None
) -> CameraFacts:
    """Return the facts known before the first frame; `limits_us` are the min and max frame duration."""
    return CameraFacts(
        kind=KIND,
        model=str(properties_of(camera).get("Model", camera.id)),
        width=layout.width,
        height=layout.height,
        pixel_format=layout.fourcc,
        period_ns=wishes.period_us * 1000,
        timestamp_source=TimestampSource.START_OF_EXPOSURE,
        phase_control=PhaseControl.RESET,
        min_frame_duration_ns=None if limits_us is None else limits_us[0] * 1000,
        max_frame_duration_ns=None if limits_us is None else limits_us[1] * 1000,
    )


def with_exposure(facts: CameraFacts, exposure_us: float | None, origin: Origin) -> CameraFacts:
    """Return the facts with an exposure, and with the delay of the timestamps that results from it.

    `exposure_us` is None if the exposure is automatic. The Raspberry Pi's driver stamps the first row as the
    sensor sends it. Its exposure is over by then, although libcamera calls the stamp the time of exposure.
    Webcams are stamped as by V4L2.
    """
    row_ns = facts.row_time_ns
    exposure_ns = None if exposure_us is None else round(exposure_us * 1000)
    if exposure_ns is not None and row_ns is not None:
        # Reported values are truncated to microseconds; a requested one between two rows is truncated, too.
        exposure_ns = int((exposure_ns + 1000) / row_ns) * row_ns
    facts = replace(facts, exposure_ns=exposure_ns, stamp=None)
    if origin == "webcam":
        return replace(facts, stamp=replace(facts.assumed_stamp, source=StampSource.PROFILE))
    if origin != "raspberry-pi" or exposure_ns is None or row_ns is None:
        return facts
    return replace(
        facts,
        stamp=StampAccuracy(
            bias_ns=exposure_ns,
            uncertainty_ns=READOUT_UNCERTAINTY_ROWS * row_ns + READOUT_UNCERTAINTY_NS,
            source=StampSource.PROFILE,
            exposure_ns=exposure_ns,
        ),
    )


def typical_period_ns(measured_ns: float) -> int:
    """Return the nominal frame period in ns for a measured one: of a whole rate or its 1/1.001 variant."""
    rate = 1e9 / measured_ns
    whole = max(1, round(rate))
    standard_rate = min((whole, whole / 1.001), key=lambda one: abs(one - rate))
    return (
        round(1e9 / standard_rate)
        if abs(standard_rate / rate - 1.0) < _TYPICAL_RATE
        else round(measured_ns / _ROUND_NS) * _ROUND_NS
    )
