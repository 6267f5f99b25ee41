"""Camera specs, `KIND:DEVICE[,key=value…]`: finding the driver, opening the camera, reading the options."""

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, cast
from urllib.parse import urlsplit

from capture_app.cameras.base import Camera, CameraDriver
from capture_app.common.camera_facts import SIMULATED
from capture_app.common.clock import NodeClock
from capture_app.common.errors import BadInputError
from capture_app.common.names import name_like
from capture_app.common.optional_packages import DISTRIBUTION
from capture_app.common.passwords import hide_password
from capture_app.common.plugins import load_plugin, load_plugins, plugin_names

GROUP = "simulshot.cameras"
"""Entry-point group of camera drivers; an entry point's name is the kind that starts a spec."""
ATTRIBUTES = ("SPEC", "HELP", "NEEDS", "OPTIONS", "open_camera", "list_cameras")
"""Attributes that a driver must have; see `CameraDriver`."""
COMMON_OPTIONS = "simulshot.camera_options"
"""Entry-point group of options that every camera has; an entry point's name is the option."""
_DEVICES = "/dev/video"
DEFAULT_SIZE = (640, 480)
DEFAULT_FPS = 30.0
_WHOLE = {"width": (1, 65_535), "height": (1, 65_535)}
_NUMBERS = {
    "fps": (0.001, 10_000.0),
    "exposure_us": (0.1, 6e7),
    "gain": (0.1, 1000.0),
    "row_us": (0.01, 1000.0),
}
"""Min and max of the options that drivers share."""


@functools.cache
def camera_kinds() -> tuple[str, ...]:
    """Return the installed camera kinds, without importing any driver."""
    return plugin_names(GROUP)


def load_driver(kind: str) -> CameraDriver:
    """Import the driver of a kind. Raises NotAvailableError if it does not load."""
    return cast(CameraDriver, load_plugin(GROUP, kind, *ATTRIBUTES))


def load_drivers() -> dict[str, CameraDriver]:
    """Import all drivers, by kind, simulated cameras last; a broken one is reported on stderr and skipped."""
    return dict(sorted(load_plugins(GROUP, *ATTRIBUTES).items(), key=lambda item: item[0] == SIMULATED))


def common_options() -> dict[str, str]:
    """Return the description of each option that every camera has, by name."""
    return {name: option.HELP for name, option in load_plugins(COMMON_OPTIONS, "HELP", "wrapper").items()}


@dataclass(frozen=True, slots=True)
class CameraSpec:
    """A camera spec `KIND:DEVICE[,key=value...]`, parsed but not opened."""

    kind: str
    device: str
    options: dict[str, str]

    @property
    def label(self) -> str:
        """Default name for the camera: its device or host, or the camera chosen from a recording."""
        named = urlsplit(self.device).hostname or Path(self.device).name
        label = name_like(self.options.get("camera", named), "camera")
        return label if any(map(str.isalpha, label)) else name_like(f"{self.kind}-{label}", "camera")


def parse_spec(spec: str) -> CameraSpec:
    """Parse a camera's spec without looking for the camera. Raises BadInputError."""
    spec = hide_password(spec).strip()
    if spec.startswith(_DEVICES):
        # A device's own path stands for the spec of the driver that takes such paths.
        kinds = (
            kind for kind, driver in load_drivers().items() if driver.SPEC.startswith(f"{kind}:{_DEVICES}")
        )
        spec = f"{next(kinds, '')}:{spec}"
    kind, _, rest = spec.partition(":")
    if kind not in camera_kinds():
        drivers = load_drivers()
        numbered = [f"{kind}:{spec}" for kind in drivers if drivers[kind].SPEC.startswith(f"{kind}:NUMBER")]
        # A bare number, as OpenCV and other programs count cameras.
        forms = " or ".join(numbered if spec.isdecimal() else (driver.SPEC for driver in drivers.values()))
        hint = f"write {forms}" if forms else f"no driver is installed: install {DISTRIBUTION} again"
        raise BadInputError(f"unknown camera {spec!r}", hint=hint)
    device, *parts = (part.strip() for part in rest.split(","))
    if not device:
        raise BadInputError(f"camera {spec!r} names no device", hint=_form(kind))
    options: dict[str, str] = {}
    for part in parts:
        key, equals, value = (piece.strip() for piece in part.partition("="))
        if not (key and equals and value):
            raise BadInputError(f"camera {spec!r}: {part!r} is not key=value", hint=_form(kind))
        key = _with_underscores(key)
        if key in options:
            raise BadInputError(f"camera {spec!r} says {key} twice", hint="leave one out")
        options[key] = value
    return CameraSpec(kind, device, options)


def _with_underscores(key: str) -> str:
    """Return an option's name as we write it; `exposure-us` is accepted as `exposure_us`."""
    return key.replace("-", "_")


def _form(kind: str) -> str:
    return f"write {load_driver(kind).SPEC}; capture-app cameras lists what there is"


def open_camera(spec: str, *, clock: NodeClock, name: str) -> Camera:
    """Open the camera of a spec for the node `name`, its timestamps in that node's clock.

    Loading a rendered scene takes a second here, so open cameras before the event loop has urgent work.
    Raises BadInputError for a spec that cannot be read, CameraError for a camera that is missing or refuses,
    NotAvailableError if this machine lacks something that the driver needs.
    """
    parsed = parse_spec(spec)
    driver = load_driver(parsed.kind)
    names = {_with_underscores(name): name for name in driver.OPTIONS}
    wrappers = [
        load_plugin(COMMON_OPTIONS, key, "wrapper").wrapper(value, parsed, clock=clock, name=name)
        for key in {*plugin_names(COMMON_OPTIONS)} - {*names}
        if (value := parsed.options.pop(key, None))
    ]
    for key in parsed.options:
        if key not in names:
            known = f"there are {', '.join(driver.OPTIONS)}" if driver.OPTIONS else "it has none"
            raise BadInputError(f"{parsed.kind} cameras have no option {key!r}", hint=known)
    options = {names[key]: value for key, value in parsed.options.items()}
    camera = driver.open_camera(parsed.device, options, clock=clock, name=name)
    for wrap in wrappers:
        camera = wrap(camera)
    return camera


def read_number(
    options: Mapping[str, str], key: str, camera: str, *, low: float, high: float
) -> float | None:
    """Read a numeric option within bounds; None if it is not given. Raises BadInputError.

    Fractions are accepted, such as a rate of 30000/1001.
    """
    text = options.get(key)
    if text is None:
        return None
    dividend, _, divisor = text.partition("/")
    try:
        value = float(dividend) / float(divisor or 1)
    except (ValueError, ZeroDivisionError):
        value = math.nan
    if not low <= value <= high:
        raise BadInputError(f"{key}={text} of {camera}", hint=f"a number from {low:g} to {high:g} is needed")
    return value


@dataclass(frozen=True, slots=True)
class CameraRequest:
    """Settings that a user requested of a camera; None selects the camera's choice or the default."""

    width: int | None = None
    """In pixels, as is the height."""
    height: int | None = None
    fps: float | None = None
    format: str | None = None
    """The pixel format, by the driver's name."""
    exposure_us: float | None = None
    gain: float | None = None
    row_us: float | None = None
    """Step of the frame duration, in us."""

    @property
    def size(self) -> tuple[int, int]:
        """Size to request in pixels; 4:3 if only one side is given."""
        width, height = self.width, self.height
        if width is not None:
            return width, height if height is not None else round(width * 3 / 4)
        return (round(height * 4 / 3), height) if height is not None else DEFAULT_SIZE

    @property
    def period_s(self) -> Fraction | None:
        """Frame period to request, as a fraction that drivers support; None if no rate was requested."""
        return None if self.fps is None else 1 / Fraction(self.fps).limit_denominator(1001)

    @property
    def period_us(self) -> int:
        """Frame period to request, in us; the default one if no rate was requested."""
        return round(1e6 / (self.fps or DEFAULT_FPS))


def read_request(options: Mapping[str, str], camera: str) -> CameraRequest:
    """Read the options that drivers share. Raises BadInputError, which names the wrong one and `camera`."""
    asked: dict[str, Any] = {"format": options.get("format")}
    for key, (low, high) in (_WHOLE | _NUMBERS).items():
        number = read_number(options, key, camera, low=low, high=high)
        if number is not None and key in _WHOLE and number != round(number):
            raise BadInputError(f"{key}={options[key]} of {camera}", hint="a whole number is needed")
        if number is not None:
            asked[key] = round(number) if key in _WHOLE else number
    return CameraRequest(**asked)
