"""Driver of libcamera cameras: discovery and opening."""

from collections.abc import Iterator, Mapping

from capture_app.cameras.base import Camera
from capture_app.cameras.libcamera.configuration import FOURCC, KIND, origin_of, parse_options
from capture_app.cameras.libcamera.libcamera_camera import LibcameraCamera
from capture_app.cameras.libcamera.libcamera_library import PACKAGE, Library, load_library
from capture_app.cameras.system_packages import is_installed
from capture_app.common.camera_facts import CameraListing
from capture_app.common.clock import NodeClock
from capture_app.common.errors import NotAvailableError

SPEC = f"{KIND}:ID[,key=value…]"
HELP = "Cameras of a Raspberry Pi and others that libcamera drives, by its id or number."
NEEDS = f"libcamera's Python bindings: sudo apt install {PACKAGE}"
OPTIONS = {
    "width": "pixels of the picture",
    "height": "the same",
    "fps": "frames a second",
    "exposure-us": "exposure, else the camera chooses it",
    "gain": "analogue gain, else the camera chooses it",
    "format": f"one of {', '.join(FOURCC.values())}",
}


def open_camera(device: str, options: Mapping[str, str], *, clock: NodeClock, name: str) -> Camera:
    """Open a camera by the library's id for it, or by its number in the list.

    See OPTIONS. Raises BadInputError for an option that cannot be read, CameraError if the camera is
    missing, busy or has no such mode, NotAvailableError if the library is missing or too old.
    """
    wishes = parse_options(options)
    return LibcameraCamera(load_library(), device, wishes).in_clock(clock)


def list_cameras() -> list[CameraListing]:
    """Return the library's cameras that V4L2 does not drive, or one entry with the load error."""
    if not is_installed("libcamera"):
        return []
    try:
        library = load_library()
    except NotAvailableError as error:
        return [CameraListing(f"{KIND}:0", KIND, "", str(error), usable=False)]
    return list(listings(library))


def listings(library: Library) -> Iterator[CameraListing]:
    """Yield the cameras of a library except webcams, which V4L2 lists and drives better."""
    for camera in library.cameras:
        properties = {control.name: value for control, value in camera.properties.items()}
        if origin_of(camera) == "webcam":
            continue
        size = properties.get("PixelArraySize")
        moved = any(control.name == "FrameDurationLimits" for control in camera.controls)
        detail = "moved by frame durations" if moved else "moved by restarts"
        sensor = f"sensor of {size.width}x{size.height}, " if size is not None else ""
        yield CameraListing(
            f"{KIND}:{camera.id}", KIND, str(properties.get("Model", camera.id)), sensor + detail
        )
