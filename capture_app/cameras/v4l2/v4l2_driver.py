"""Driver of USB webcams and other Video4Linux2 cameras: discovery and opening."""

import errno
import os
import stat
import time
from collections.abc import Iterator, Mapping
from contextlib import closing
from pathlib import Path

from capture_app.cameras.base import Camera
from capture_app.cameras.v4l2.driver_errors import driver_error
from capture_app.cameras.v4l2.kernel import VideoDevice
from capture_app.cameras.v4l2.modes import check_capture, configure, offered_modes, parse_options
from capture_app.cameras.v4l2.v4l2_stream import V4L2Camera
from capture_app.common.camera_facts import CameraListing
from capture_app.common.clock import NodeClock
from capture_app.common.errors import CameraError

SPEC = "v4l2:/dev/videoN[,key=value…]"
HELP = "USB webcams and other Video4Linux cameras of Linux."
NEEDS = ""
OPTIONS = {
    "width": "pixels of the picture",
    "height": "the same",
    "fps": "frames a second",
    "format": "pixel format, such as MJPG, YUYV or GREY",
}
VIDEO4LINUX_MAJOR = 81
"""Linux's major number of Video4Linux device nodes."""
WAKING_TRIES = 5
WAKING_PAUSE_S = 0.1


def open_camera(path: str, options: Mapping[str, str], *, clock: NodeClock, name: str) -> Camera:
    """Open a camera by its device node; see OPTIONS.

    Raises BadInputError for an option that cannot be read; CameraError if the device is missing, not a
    camera, busy, not permitted, without the requested mode, or stamps frames in another clock;
    NotAvailableError on a 32-bit system. May take half a second if the camera sleeps.
    """
    request = parse_options(options)
    try:
        device = open_video_node(path)
        try:
            check_capture(path, device.capability())
            layout, period = configure(device, request)
            return V4L2Camera(device, layout, round(period * 1_000_000_000)).in_clock(clock)
        except BaseException:
            device.close()
            raise
    except OSError as error:
        raise driver_error(path, error) from error


def open_video_node(path: str) -> VideoDevice:
    """Open a node after checking that it is a Video4Linux node: opening others may have side effects.

    Raises CameraError for another kind of node, OSError from the driver.
    """
    status = Path(path).stat()
    if not (stat.S_ISCHR(status.st_mode) and os.major(status.st_rdev) == VIDEO4LINUX_MAJOR):
        raise CameraError(f"{path} is not a camera", hint="`capture-app cameras` lists the cameras")
    for _ in range(WAKING_TRIES - 1):
        try:
            return VideoDevice(path)
        except OSError as error:
            if error.errno != errno.EBUSY:
                raise
            # A sleeping USB camera answers so while its hub wakes up; uvcvideo never means "in use" here.
            time.sleep(WAKING_PAUSE_S)
    return VideoDevice(path)


def list_cameras(folder: Path = Path("/dev")) -> list[CameraListing]:
    """Return the V4L2 cameras of this machine in the order of their numbers, including unusable ones."""
    nodes = [node for node in folder.glob("video*") if node.name[5:].isdecimal()]
    ordered = sorted(nodes, key=lambda node: int(node.name[5:]))
    return [listing for node in ordered for listing in _listings(node)]


def _listings(node: Path) -> Iterator[CameraListing]:
    """Yield the listing of one node; nothing if it delivers no images."""
    spec = f"v4l2:{node}"
    try:
        with closing(open_video_node(str(node))) as device:
            capability = device.capability()
            check_capture(str(node), capability)
            detail = ", ".join(map(str, offered_modes(device)))
            yield CameraListing(spec, "v4l2", capability.card, detail)
    except CameraError:
        return
    except OSError as error:
        name = Path("/sys/class/video4linux", node.name, "name")
        card = name.read_text().strip() if name.is_file() else ""
        yield CameraListing(spec, "v4l2", card, str(driver_error(str(node), error)), usable=False)
