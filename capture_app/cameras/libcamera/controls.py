"""The controls of a camera of libcamera by their names, as far as it has them."""

from collections.abc import Iterable, Mapping
from typing import Any

from capture_app.cameras.libcamera.mode import Wishes


class KnownControls:
    """What can be set for a camera, from one request on; libraries differ in what they have."""

    def __init__(self, camera: Any) -> None:
        self._known = {control.name: (control, limits) for control, limits in camera.controls.items()}

    def __contains__(self, name: str) -> bool:
        return name in self._known

    def limits(self, name: str) -> tuple[Any, Any] | None:
        """Least and most of a control; None where there is none."""
        if name not in self._known:
            return None
        limits = self._known[name][1]
        return limits.min, limits.max

    def of(self, values: Mapping[str, Any]) -> dict[Any, Any]:
        """Those of these values that the camera has a control for, as the library takes them."""
        return {self._known[name][0]: value for name, value in values.items() if name in self._known}


def frame_duration(duration_us: int) -> dict[str, Any]:
    """The setting that lets a frame last that long."""
    return {"FrameDurationLimits": (duration_us, duration_us)}


def first_exposure(controls: KnownControls, wishes: Wishes) -> dict[str, Any]:
    """The exposure and gain that a stream starts with: the camera's own where nothing is asked."""
    asked = {"ExposureTime": wishes.exposure_us, "AnalogueGain": wishes.gain}
    fixed = {name: value for name, value in asked.items() if value is not None}
    # One of two alone leaves the other automatic, until both are held.
    all_fixed = fixed and all(name in fixed for name in asked if name in controls)
    return {"AeEnable": False, **fixed} if all_fixed else fixed


def held_exposure(metadata: Mapping[str, Any], wishes: Wishes) -> dict[str, Any]:
    """The settings that hold exposure, gain and white balance where a frame had them, or where asked for."""
    exposure_us = wishes.exposure_us or metadata.get("ExposureTime")
    gain = wishes.gain or metadata.get("AnalogueGain")
    colours = metadata.get("ColourGains")
    held: dict[str, Any] = {"AeEnable": False, "ExposureTime": exposure_us, "AnalogueGain": gain}
    if colours:
        held |= {"AwbEnable": False, "ColourGains": tuple(colours)}
    return {name: value for name, value in held.items() if value is not None}


def by_name(metadata: Mapping[Any, Any], names: Iterable[str]) -> dict[str, Any]:
    """Those of a request's metadata that are named."""
    wanted = set(names)
    return {control.name: value for control, value in metadata.items() if control.name in wanted}
