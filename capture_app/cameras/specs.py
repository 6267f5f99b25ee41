"""KIND:DEVICE,key=value: which drivers there are, how options are read.

Which cameras there are, and how to open one by its spec: `KIND:DEVICE[,key=value…]`.

The options of a camera's spec, as drivers read them.
"""

import importlib
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from capture_app.cameras.base import Camera, CameraDriver, CameraListing
from capture_app.clock import NodeClock
from capture_app.errors import BadInputError
from capture_app.names import name_like


@dataclass(frozen=True, slots=True)
class DriverEntry:
    """Where a driver is, and how its specs are written; the driver is imported when it is asked for."""

    module: str
    """Its functions are those of `CameraDriver`."""
    spec_form: str

    def load(self) -> CameraDriver:
        """Import the driver."""
        return cast(CameraDriver, importlib.import_module(self.module))


DRIVERS = {
    "sim": DriverEntry("capture_app.simulation.driver", "sim:PROFILE[,scene=NAME][,view=NAME][,key=value…]"),
    "v4l2": DriverEntry("capture_app.cameras.v4l2.driver", "v4l2:/dev/videoN[,key=value…]"),
    "aravis": DriverEntry("capture_app.cameras.aravis.driver", "aravis:ADDRESS[,key=value…]"),
    "webcam": DriverEntry("capture_app.cameras.webcam", "webcam:NUMBER[,key=value…]"),
    "replay": DriverEntry("capture_app.cameras.replay.driver", "replay:PATH[,camera=NAME][,key=value…]"),
    "libcamera": DriverEntry("capture_app.cameras.libcamera.driver", "libcamera:ID[,key=value…]"),
}
"""By the kind that a spec begins with. By name, so that what drives simulated cameras may lie above."""


@dataclass(frozen=True, slots=True)
class CameraSpec:
    """A camera's spec taken apart."""

    kind: str
    device: str
    options: dict[str, str]

    @property
    def label(self) -> str:
        """What the camera may be named after it: its device, or the camera of a recording."""
        label = name_like(self.options.get("camera", Path(self.device).name), "camera")
        return label if any(map(str.isalpha, label)) else name_like(f"{self.kind}-{label}", "camera")


def parse_spec(spec: str) -> CameraSpec:
    """Take a camera's spec apart, without looking for the camera. Raises BadInputError."""
    kind, _, rest = spec.strip().partition(":")
    if kind not in DRIVERS:
        forms = " or ".join(driver.spec_form for driver in DRIVERS.values())
        raise BadInputError(f"unknown camera {spec!r}", hint=f"write {forms}")
    hint = f"write {DRIVERS[kind].spec_form}"
    device, *parts = (part.strip() for part in rest.split(","))
    if not device:
        raise BadInputError(f"camera {spec!r} names no device", hint=hint)
    options: dict[str, str] = {}
    for part in parts:
        key, equals, value = (piece.strip() for piece in part.partition("="))
        if not (key and equals and value):
            raise BadInputError(f"camera {spec!r}: {part!r} is not key=value", hint=hint)
        if key in options:
            raise BadInputError(f"camera {spec!r} says {key} twice", hint="leave one out")
        options[key] = value
    return CameraSpec(kind, device, options)


def open_camera(spec: str, *, clock: NodeClock, name: str) -> Camera:
    """Open the camera of a spec for the node `name`, its timestamps in that node's clock.

    Rendered scenes are loaded here, which takes a second: open before the event loop has work that is urgent.
    Raises BadInputError for a spec that cannot be read, CameraError for a camera that is missing or refuses,
    NotAvailableError for what this machine does not have.
    """
    parsed = parse_spec(spec)
    return DRIVERS[parsed.kind].load().open_camera(parsed.device, parsed.options, clock=clock, name=name)


def modes_of(spec: str) -> str:
    """What the camera of a spec offers, in its driver's words; empty where it is not listed."""
    parsed = parse_spec(spec)
    listed = DRIVERS[parsed.kind].load().list_cameras()
    return next((one.detail for one in listed if one.spec == f"{parsed.kind}:{parsed.device}"), "")


def list_cameras() -> list[CameraListing]:
    """The cameras of this machine, its real devices first, then the simulated models."""
    drivers = sorted(DRIVERS, key=lambda kind: kind == "sim")
    return [listing for kind in drivers for listing in DRIVERS[kind].load().list_cameras()]


def refuse_unknown(options: Mapping[str, str], known: Iterable[str], camera: str) -> None:
    """Raise BadInputError for an option that is none of those known; `camera` says of what, as `a webcam`."""
    names = tuple(known)
    for key in options:
        if key not in names:
            raise BadInputError(f"{camera} has no option {key!r}", hint=f"there are {', '.join(names)}")


def read_number(
    options: Mapping[str, str], key: str, camera: str, *, least: float, most: float
) -> float | None:
    """Read an option that is a number within bounds; None where it is not given. Raises BadInputError."""
    text = options.get(key)
    if text is None:
        return None
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not least <= value <= most:
        raise BadInputError(
            f"{key}={text} of {camera}", hint=f"a number from {least:g} to {most:g} is needed"
        )
    return value
