"""The exposure controls of a V4L2 camera."""

from contextlib import suppress

from capture_app.cameras.v4l2 import layout as v4l2
from capture_app.cameras.v4l2.ioctl import VideoDevice

_UNIT_NS = 100_000
"""Of the control of the exposure."""


def exposure_limits_ns(device: VideoDevice) -> tuple[int | None, int | None]:
    """Shortest and longest exposure in ns; None where the camera has no such control."""
    limits = device.control_range(v4l2.CID_EXPOSURE_ABSOLUTE)
    return (limits[0] * _UNIT_NS, limits[1] * _UNIT_NS) if limits else (None, None)


def read_exposure(device: VideoDevice) -> tuple[int | None, float | None]:
    """Exposure in ns and gain in the device's unit, None where the camera chooses them frame by frame."""
    automatic = device.control(v4l2.CID_EXPOSURE_AUTO)
    if automatic not in (None, v4l2.EXPOSURE_MANUAL):
        return None, None
    exposure, gain = device.control(v4l2.CID_EXPOSURE_ABSOLUTE), device.control(v4l2.CID_GAIN)
    return (
        None if exposure is None else exposure * _UNIT_NS,
        None if gain is None or device.control(v4l2.CID_AUTOGAIN) else float(gain),
    )


def keep_rate_constant(device: VideoDevice) -> int | None:
    """Forbid longer frames in the dark; returns the setting to restore, None where there is nothing to."""
    before = device.control(v4l2.CID_EXPOSURE_AUTO_PRIORITY)
    if not before:
        return None
    with suppress(OSError):
        device.set_control(v4l2.CID_EXPOSURE_AUTO_PRIORITY, 0)
    return before


def restore_rate(device: VideoDevice, before: int | None) -> None:
    """Set what `keep_rate_constant` returned."""
    if before is not None:
        with suppress(OSError):
            device.set_control(v4l2.CID_EXPOSURE_AUTO_PRIORITY, before)
