"""Driver of simulated cameras: listing the models, and opening one from its spec."""

import random
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from capture_app.cameras.specs import read_number
from capture_app.common.camera_facts import SIMULATED, CameraListing
from capture_app.common.clock import NodeClock
from capture_app.common.errors import BadInputError
from capture_app.simulation.profiles import PROFILES, SensorProfile, find_profile
from capture_app.simulation.rendering.picture_source import (
    LED_PANEL,
    TEST_CARD,
    PictureSource,
    Replay,
    open_picture_source,
)
from capture_app.simulation.sensor import Sensor
from capture_app.simulation.simulated_camera import SimulatedCamera, stable_seed

SPEC = f"{SIMULATED}:PROFILE[,scene=NAME][,view=NAME][,key=value…]"
HELP = "Simulated cameras of a phone, a Raspberry Pi or a webcam, that see a rendered scene."
NEEDS = ""
OPTIONS = {
    "scene": f"what it sees: a scene's name, {LED_PANEL}, or {TEST_CARD}, a test card (default)",
    "view": "the scene's view; default: the one named like the node",
    "replay": "an MJPEG file whose pictures it gives, instead of a scene",
    "scale": "size of the pictures, 0.1 to 1 of the full size",
    "samples": "rays of each pixel of a scene, 1 to 4 (default): fewer are quicker and rougher",
    "calibration": "none: sessions do not get the scene's true calibration",
    "seed": "whole number; with the node's name it chooses crystal, noise and drops",
    "exposure_ms": "exposure of every frame",
    "auto": "exposure: the camera chooses the exposure, which varies slightly, until it is set",
    "ppm": "error of this device's crystal",
    "noise_us": "standard deviation of the timestamps",
    "stamp_bias_ms": "all timestamps are late by this, and the camera does not know it, as no real one does",
    "outliers": "fraction of timestamps that are late, 0 to 1",
    "drops": "fraction of frames that never arrive, 0 to 1",
    "start_ms": "time from the start command to the first frame, without its scatter",
    "fail_after_s": "the camera goes away this long after its start",
}

_CAMERA = "a simulated camera"
_CHANGES: dict[str, tuple[float, Callable[[float], dict[str, Any]]]] = {
    "exposure_ms": (1e3, lambda ms: {"exposure_ns": round(ms * 1e6)}),
    "noise_us": (1e4, lambda us: {"timestamp_noise_ns": round(us * 1e3)}),
    "stamp_bias_ms": (100, lambda ms: {"stamp_bias_ns": round(ms * 1e6)}),
    "outliers": (1, lambda fraction: {"outlier_fraction": fraction}),
    "drops": (1, lambda fraction: {"drop_fraction": fraction}),
    "start_ms": (1e4, lambda ms: {"start_latency_ns": (round(ms * 1e6), 0)}),
}
"""Max value of an option, whose min is 0, and the change that it makes to the profile."""


def list_cameras() -> list[CameraListing]:
    """Return the simulated models."""
    return [
        CameraListing(
            spec=f"sim:{profile.name}",
            kind=SIMULATED,
            model=profile.model,
            detail=f"{profile.image_width}x{profile.image_rows} at {1e9 / profile.period_ns:.0f} frames/s, "
            f"moves its phase by {profile.phase_control}",
        )
        for profile in PROFILES.values()
    ]


def open_camera(profile: str, options: Mapping[str, str], *, clock: NodeClock, name: str) -> SimulatedCamera:
    """Open a simulated camera of a model of `simulation.profiles` for the node `name`; see OPTIONS.

    Raises BadInputError for an unknown profile, scene, view, option or value, and NotAvailableError if
    this machine cannot render scenes.
    """
    model = _adjusted(find_profile(profile), options)
    scale = read_number(options, "scale", _CAMERA, low=0.1, high=1)
    camera_seed = stable_seed(f"{name}/{_seed(options)}")
    source: PictureSource
    if "replay" in options:
        if not {"scene", "view", "scale"}.isdisjoint(options):
            hint = "leave scene=, view= and scale= out"
            raise BadInputError("a camera that replays a file has no scene", hint=hint)
        source = Replay.open(Path(options["replay"]))
    else:
        source = open_picture_source(
            options.get("scene", TEST_CARD),
            options.get("view", ""),
            camera=name,
            width=model.image_width,
            height=model.image_rows,
            row_time_ns=model.row_time_ns,
            scale=1.0 if scale is None else scale,
            samples=int(read_number(options, "samples", _CAMERA, low=1, high=4) or 4),
        )
    sensor = Sensor(
        replace(model, image_rows=source.height),
        random.Random(camera_seed),
        period_error_ppm=read_number(options, "ppm", _CAMERA, low=-1000, high=1000),
    )
    fail_after_s = read_number(options, "fail_after_s", _CAMERA, low=0, high=1e6)
    fail_after_ns = None if fail_after_s is None else round(fail_after_s * 1e9)
    return SimulatedCamera(
        sensor,
        source,
        clock,
        seed=camera_seed,
        fail_after_ns=fail_after_ns,
        calibrated=not _says(options, "calibration", "none", otherwise="true"),
        automatic=_says(options, "auto", "exposure"),
    )


def _adjusted(profile: SensorProfile, options: Mapping[str, str]) -> SensorProfile:
    """Return the profile with the options' changes; the profile validates the exposure."""
    for key, (max_value, change) in _CHANGES.items():
        value = read_number(options, key, _CAMERA, low=0, high=max_value)
        if value is not None:
            profile = replace(profile, **change(value))
    return profile


def _says(options: Mapping[str, str], key: str, value: str, *, otherwise: str = "") -> bool:
    """Return whether an option is `value`; its only other valid value is `otherwise`."""
    text = options.get(key, otherwise)
    if text not in (value, otherwise):
        raise BadInputError(f"{key}={text} of a simulated camera", hint=f"{value}, or leave it out")
    return text == value


def _seed(options: Mapping[str, str]) -> int:
    text = options.get("seed", "0")
    try:
        return int(text)
    except ValueError:
        raise BadInputError(f"seed={text} is not a whole number", hint="such as seed=1") from None
