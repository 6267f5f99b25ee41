"""Exposure, gain, white balance and focus of a camera of libcamera, as all cameras have them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from capture_app.camera_controls import DIOPTRES, KELVIN, MICROSECONDS, TIMES, Control, ControlState
from capture_app.cameras.libcamera.controls import KnownControls
from capture_app.errors import CameraError

_MANUAL_FOCUS, _CONTINUOUS_FOCUS = 0, 2


@dataclass(frozen=True, slots=True)
class _Control:
    """A control of the library, and the switch that lets the camera choose it: what that is off, and on."""

    value: str
    unit: str
    switch: str
    manual: bool | int = False
    automatic: bool | int = True
    together: tuple[str, ...] = ()
    """What the same switch decides, or what contradicts it."""


_CONTROLS = {
    Control.EXPOSURE: _Control("ExposureTime", MICROSECONDS, "AeEnable", together=("AnalogueGain",)),
    Control.GAIN: _Control("AnalogueGain", TIMES, "AeEnable", together=("ExposureTime",)),
    Control.WHITE_BALANCE: _Control("ColourTemperature", KELVIN, "AwbEnable", together=("ColourGains",)),
    Control.FOCUS: _Control("LensPosition", DIOPTRES, "AfMode", _MANUAL_FOCUS, _CONTINUOUS_FOCUS),
}
_WITH = "AeEnable"
"""The switch that holds two values: setting one holds the other where it is."""


def read_states(
    known: KnownControls, settings: Mapping[str, Any], told: Mapping[str, Any], period_us: int
) -> tuple[ControlState, ...]:
    """The controls as they stand by what is set, and what the last frame told; periods bound exposures."""
    states: list[ControlState] = []
    for control, of in _CONTROLS.items():
        limits = known.limits(of.value)
        if limits is None:
            continue
        value = told.get(of.value, settings.get(of.value))
        states.append(
            ControlState(
                control=control,
                value=None if value is None else float(value),
                unit=of.unit,
                automatic=of.switch in known and settings.get(of.switch, of.automatic) == of.automatic,
                can_be_automatic=of.switch in known,
                least=float(limits[0]),
                most=float(min(limits[1], period_us) if control is Control.EXPOSURE else limits[1]),
            )
        )
    return tuple(states)


def new_settings(
    known: KnownControls, control: Control, value: float | None, told: Mapping[str, Any]
) -> tuple[dict[str, Any], tuple[str, ...]]:
    """What to set for a control in its unit, None for the camera's own choice; and what to set no longer.

    Raises CameraError where the camera has no such control.
    """
    of = _CONTROLS[control]
    if of.value not in known or (value is None and of.switch not in known):
        raise CameraError(
            f"this camera has no {'automatic' if value is None else 'control of its'} {control}"
        )
    if value is None:
        return {of.switch: of.automatic}, (of.value, *of.together)
    number = round(value) if control in (Control.EXPOSURE, Control.WHITE_BALANCE) else float(value)
    settings = {of.switch: of.manual, of.value: number}
    if of.switch != _WITH:
        return settings, of.together
    return {**{name: told[name] for name in of.together if name in told}, **settings}, ()
