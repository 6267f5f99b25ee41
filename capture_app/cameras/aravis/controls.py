"""Exposure and gain of a machine-vision camera, by GenICam's features."""

from typing import Any

from capture_app.camera_controls import MICROSECONDS, Control, ControlState, steps_of
from capture_app.cameras.aravis.machine_device import DeviceSetup
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
