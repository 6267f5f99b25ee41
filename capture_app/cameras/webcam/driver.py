"""Webcams by OpenCV: finding and opening them."""

import functools
import platform
from collections.abc import Mapping

from capture_app.cameras.base import Camera, CameraListing, in_node_clock
from capture_app.cameras.webcam.camera import KIND, WebcamCamera
from capture_app.cameras.webcam.capture import Webcam, WebcamRequest, parse_options
from capture_app.clock import NodeClock
from capture_app.errors import BadInputError, CameraError

MOST_LISTED = 8


def open_camera(number: str, options: Mapping[str, str], *, clock: NodeClock, name: str) -> Camera:
    """Make a webcam of its number; it is opened when it is started.

    Raises BadInputError for what is no number, or an option that cannot be read.
    """
    if not (number.isascii() and number.isdecimal() and int(number) < 256):
        raise BadInputError(f"webcam:{number} is not a webcam", hint="they have numbers: webcam:0")
    request = parse_options(options)
    return in_node_clock(WebcamCamera(functools.partial(Webcam, int(number), request)), clock)


def list_cameras() -> list[CameraListing]:
    """The webcams by their numbers; none on Linux, whose own driver stamps far better."""
    if platform.system() == "Linux":
        return []
    found = []
    for index in range(MOST_LISTED):
        try:
            webcam = Webcam(index, WebcamRequest())
        except CameraError:
            break
        webcam.close()
        detail = "by OpenCV: stamped as frames arrive, sure to tens of milliseconds"
        found.append(CameraListing(f"{KIND}:{index}", KIND, f"Webcam {index}", detail))
    return found
