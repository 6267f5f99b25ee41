"""Which cameras there are, and how to open one by its spec: `KIND:DEVICE[,key=value…]`."""

from dataclasses import dataclass

from capture_app.cameras.base import Camera
from capture_app.cameras.reclocked import ReclockedCamera
from capture_app.cameras.simulated_spec import open_simulated
from capture_app.clock import HostClock, NodeClock
from capture_app.errors import BadInputError
from capture_app.simulation.devices.profiles import PROFILES

KINDS = {
    "sim": "sim:PROFILE[,scene=NAME][,view=NAME][,key=value…]",
    "v4l2": "v4l2:/dev/videoN[,key=value…]",
}


@dataclass(frozen=True, slots=True)
class CameraListing:
    """One camera: its spec, and what it is in words; or, where it is not usable, why."""

    spec: str
    kind: str
    model: str
    detail: str
    usable: bool = True


@dataclass(frozen=True, slots=True)
class CameraSpec:
    """A camera's spec taken apart."""

    kind: str
    device: str
    options: dict[str, str]


def parse_spec(spec: str) -> CameraSpec:
    """Take a camera's spec apart, without looking for the camera. Raises BadInputError."""
    kind, _, rest = spec.strip().partition(":")
    if kind not in KINDS:
        raise BadInputError(f"unknown camera {spec!r}", hint=f"write {' or '.join(KINDS.values())}")
    device, *parts = (part.strip() for part in rest.split(","))
    if not device:
        raise BadInputError(f"camera {spec!r} names no device", hint=f"write {KINDS[kind]}")
    options: dict[str, str] = {}
    for part in parts:
        key, equals, value = (piece.strip() for piece in part.partition("="))
        if not (key and equals and value):
            raise BadInputError(f"camera {spec!r}: {part!r} is not key=value", hint=f"write {KINDS[kind]}")
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
    if parsed.kind == "sim":
        return open_simulated(parsed.device, parsed.options, clock=clock, name=name)
    from capture_app.cameras.v4l2 import open_v4l2

    camera = open_v4l2(parsed.device, parsed.options)
    return camera if isinstance(clock, HostClock) else ReclockedCamera(camera, clock)


def list_cameras() -> list[CameraListing]:
    """The cameras of this machine, its video devices first, then the simulated models."""
    from capture_app.cameras.v4l2 import list_devices

    devices = [
        CameraListing(
            spec=f"v4l2:{device.path}",
            kind="v4l2",
            model=device.card,
            detail=device.problem or ", ".join(str(mode) for mode in device.modes),
            usable=not device.problem,
        )
        for device in list_devices()
    ]
    models = [
        CameraListing(
            spec=f"sim:{profile.name}",
            kind="sim",
            model=profile.model,
            detail=f"{profile.image_width}x{profile.image_rows} at {1e9 / profile.period_ns:.0f} frames/s, "
            f"moves its phase by {profile.phase_control}",
        )
        for profile in PROFILES.values()
    ]
    return devices + models
