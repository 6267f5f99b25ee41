"""Controls of a libcamera camera by name: exposure, gain, white balance, focus, frame duration."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from capture_app.cameras.specs import CameraRequest
from capture_app.common.camera_facts import DIOPTRES, KELVIN, MICROSECONDS, TIMES, Control, ControlState
from capture_app.common.errors import CameraError


class KnownControls:
    """Controls that a camera accepts in requests; libraries differ in which they have."""

    def __init__(self, camera: Any) -> None:
        self._known = {control.name: (control, limits) for control, limits in camera.controls.items()}

    def __contains__(self, name: str) -> bool:
        return name in self._known

    def limits(self, name: str) -> tuple[Any, Any] | None:
        """Return min and max of a control; None if the camera does not have it."""
        if name not in self._known:
            return None
        limits = self._known[name][1]
        return limits.min, limits.max

    def of(self, values: Mapping[str, Any]) -> dict[Any, Any]:
        """Return the values for which the camera has a control, keyed as the library requires."""
        return {self._known[name][0]: value for name, value in values.items() if name in self._known}


def first_exposure(controls: KnownControls, wishes: CameraRequest) -> dict[str, Any]:
    """Return the exposure and gain that a stream starts with; empty where nothing was requested."""
    asked = {"ExposureTime": wishes.exposure_us, "AnalogueGain": wishes.gain}
    fixed = {name: value for name, value in asked.items() if value is not None}
    # With only one of the two set, the other stays automatic until both are fixed.
    all_fixed = fixed and all(name in fixed for name in asked if name in controls)
    return {"AeEnable": False, **fixed} if all_fixed else fixed


def held_exposure(metadata: Mapping[str, Any], wishes: CameraRequest) -> dict[str, Any]:
    """Return settings that fix exposure, gain and white balance at a frame's values or at requested ones."""
    exposure_us = wishes.exposure_us or metadata.get("ExposureTime")
    gain = wishes.gain or metadata.get("AnalogueGain")
    colours = metadata.get("ColourGains")
    held: dict[str, Any] = {"AeEnable": False, "ExposureTime": exposure_us, "AnalogueGain": gain}
    if colours:
        held |= {"AwbEnable": False, "ColourGains": tuple(colours)}
    return {name: value for name, value in held.items() if value is not None}


@dataclass(frozen=True, slots=True)
class _Control:
    """A control of the library, and the switch that makes it automatic, with its two values."""

    value: str
    unit: str
    switch: str
    manual: bool | int = False
    automatic: bool | int = True
    together: tuple[str, ...] = ()
    """Other values that the same switch governs, or that contradict this one."""


_CONTROLS = {
    Control.EXPOSURE: _Control("ExposureTime", MICROSECONDS, "AeEnable", together=("AnalogueGain",)),
    Control.GAIN: _Control("AnalogueGain", TIMES, "AeEnable", together=("ExposureTime",)),
    Control.WHITE_BALANCE: _Control("ColourTemperature", KELVIN, "AwbEnable", together=("ColourGains",)),
    Control.FOCUS: _Control("LensPosition", DIOPTRES, "AfMode", manual=0, automatic=2),
}


def read_states(
    known: KnownControls, settings: Mapping[str, Any], metadata: Mapping[str, Any], period_us: int
) -> tuple[ControlState, ...]:
    """Return the controls' state from the settings and the last frame; the period limits the exposure."""
    states: list[ControlState] = []
    for control, of in _CONTROLS.items():
        limits = known.limits(of.value)
        if limits is None:
            continue
        value = metadata.get(of.value, settings.get(of.value))
        states.append(
            ControlState(
                control=control,
                value=None if value is None else float(value),
                unit=of.unit,
                automatic=of.switch in known and settings.get(of.switch, of.automatic) == of.automatic,
                can_be_automatic=of.switch in known,
                minimum=float(limits[0]),
                maximum=float(min(limits[1], period_us) if control is Control.EXPOSURE else limits[1]),
            )
        )
    return tuple(states)


def new_settings(
    known: KnownControls, control: Control, value: float | None, metadata: Mapping[str, Any]
) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Return settings for a control in its unit, None for automatic; and names of settings to drop.

    Raises CameraError if the camera has no such control.
    """
    of = _CONTROLS[control]
    if of.value not in known or (value is None and of.switch not in known):
        raise CameraError(
            f"this camera has no {'automatic' if value is None else 'control of its'} {control}",
            hint="capture-app cameras controls shows what each camera can set",
        )
    if value is None:
        return {of.switch: of.automatic}, (of.value, *of.together)
    number = round(value) if control in (Control.EXPOSURE, Control.WHITE_BALANCE) else float(value)
    settings = {of.switch: of.manual, of.value: number}
    if of.switch != "AeEnable":
        return settings, of.together
    # Exposure and gain share their switch: setting one fixes the other at its current value.
    return {**{name: metadata[name] for name in of.together if name in metadata}, **settings}, ()
