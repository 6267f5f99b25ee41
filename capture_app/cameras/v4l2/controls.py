"""Exposure, gain, white balance and focus of a V4L2 camera, by the kernel's controls of any driver."""

from contextlib import suppress
from dataclasses import dataclass

from capture_app.camera_controls import KELVIN, MICROSECONDS, Control, ControlState, steps_of
from capture_app.cameras.v4l2 import layout as v4l2
from capture_app.cameras.v4l2.ioctl import VideoDevice
from capture_app.errors import CameraError

_EXPOSURE_UNIT_US = 100.0


@dataclass(frozen=True, slots=True)
class _Control:
    """A control of a value, and the switch that lets the camera choose it: what that is off, and on."""

    value: int
    switch: int
    manual: int = 0
    automatic: tuple[int, ...] = (1,)
    """The first of these that the driver takes."""
    unit: str | None = None
    """None for steps of that model."""
    scale: float = 1.0
    """Of one step, in `unit`."""


_CONTROLS = {
    Control.EXPOSURE: _Control(
        v4l2.CID_EXPOSURE_ABSOLUTE,
        v4l2.CID_EXPOSURE_AUTO,
        manual=v4l2.EXPOSURE_MANUAL,
        # Webcams keep the aperture, which they cannot move; others call the same plainly automatic.
        automatic=(v4l2.EXPOSURE_APERTURE_PRIORITY, v4l2.EXPOSURE_AUTO),
        unit=MICROSECONDS,
        scale=_EXPOSURE_UNIT_US,
    ),
    Control.GAIN: _Control(v4l2.CID_GAIN, v4l2.CID_AUTOGAIN),
    Control.WHITE_BALANCE: _Control(v4l2.CID_WHITE_BALANCE_K, v4l2.CID_AUTO_WHITE_BALANCE, unit=KELVIN),
    Control.FOCUS: _Control(v4l2.CID_FOCUS_ABSOLUTE, v4l2.CID_FOCUS_AUTO),
}


def read_controls(device: VideoDevice, model: str) -> tuple[ControlState, ...]:
    """Those that the device has."""
    return tuple(state for control in Control if (state := _read(device, model, control)) is not None)


def set_control(device: VideoDevice, control: Control, value: float | None) -> None:
    """Set a control in its unit, and hold it there; None: let the camera choose.

    Raises CameraError where the device has no such control, OSError of the driver.
    """
    of = _CONTROLS[control]
    if value is None:
        _set_automatic(device, control, of)
        return
    if device.control_range(of.value) is None:
        raise CameraError(f"{device.path} has no control of its {control}")
    if device.control(of.switch) not in (None, of.manual):
        device.set_control(of.switch, of.manual)
    device.set_control(of.value, round(value / of.scale))


def _read(device: VideoDevice, model: str, control: Control) -> ControlState | None:
    of = _CONTROLS[control]
    limits = device.control_range(of.value)
    if limits is None:
        return None
    switch, value = device.control(of.switch), device.control(of.value)
    return ControlState(
        control=control,
        value=None if value is None else value * of.scale,
        unit=of.unit or steps_of(model),
        automatic=switch not in (None, of.manual),
        can_be_automatic=switch is not None,
        least=limits[0] * of.scale,
        most=limits[1] * of.scale,
    )


def _set_automatic(device: VideoDevice, control: Control, of: _Control) -> None:
    switch = device.control(of.switch)
    if switch is None:
        raise CameraError(f"{device.path} does not choose its {control} itself")
    if switch in of.automatic:
        return
    for choice in of.automatic[:-1]:
        with suppress(OSError):
            device.set_control(of.switch, choice)
            return
    device.set_control(of.switch, of.automatic[-1])
