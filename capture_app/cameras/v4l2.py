"""USB webcams and other Video4Linux2 cameras: finding and opening them."""

import errno
import os
import stat
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from capture_app.cameras.v4l2_ioctl import VideoDevice
from capture_app.cameras.v4l2_modes import (
    Mode,
    check_capture,
    configure,
    explain,
    offered_modes,
    parse_options,
)
from capture_app.cameras.v4l2_stream import V4L2Camera
from capture_app.errors import CameraError

__all__ = ["DeviceInfo", "V4L2Camera", "list_devices", "open_v4l2"]

_VIDEO4LINUX_MAJOR = 81
_WAKING_TRIES = 4
_WAKING_PAUSE_S = 0.1


@dataclass(frozen=True, slots=True)
class DeviceInfo:
    """A camera as `capture-app cameras` lists it; `problem` says why it cannot be used, if so."""

    path: str
    card: str
    driver: str
    bus: str
    modes: tuple[Mode, ...]
    problem: str = ""


def open_v4l2(path: str, options: Mapping[str, str]) -> V4L2Camera:
    """Open a camera by its device node, with the options width, height (pixels), fps and format.

    Raises BadInputError for an option that cannot be read; CameraError where the device is missing, not a
    camera, busy, not permitted, without the mode asked for, or stamps frames in another clock;
    NotAvailableError on a 32-bit system. May take half a second where the camera sleeps.
    """
    wanted = parse_options(options)
    try:
        device = _open_video_node(path)
        try:
            check_capture(path, device.capability())
            layout, period = configure(device, wanted)
            return V4L2Camera(device, layout, round(period * 1_000_000_000))
        except BaseException:
            device.close()
            raise
    except OSError as error:
        raise explain(path, error) from error


def list_devices(folder: Path = Path("/dev")) -> tuple[DeviceInfo, ...]:
    """The V4L2 cameras of this machine in the order of their numbers, with those that cannot be used."""
    nodes = [node for node in folder.glob("video*") if node.name[5:].isdecimal()]
    found = (_describe(node) for node in sorted(nodes, key=lambda node: int(node.name[5:])))
    return tuple(info for info in found if info is not None)


def _describe(node: Path) -> DeviceInfo | None:
    """What one node is; None where it delivers no pictures."""
    path = str(node)
    try:
        device = _open_video_node(path)
        try:
            capability = device.capability()
            check_capture(path, capability)
            return DeviceInfo(path, capability.card, capability.driver, capability.bus, offered_modes(device))
        finally:
            device.close()
    except CameraError:
        return None
    except OSError as error:
        name = Path("/sys/class/video4linux", node.name, "name")
        card = name.read_text().strip() if name.is_file() else ""
        return DeviceInfo(path, card, "", "", (), problem=str(explain(path, error)))


def _open_video_node(path: str) -> VideoDevice:
    """Open a node once it is known to be one of Video4Linux: opening others may have effects of its own."""
    status = Path(path).stat()
    if not (stat.S_ISCHR(status.st_mode) and os.major(status.st_rdev) == _VIDEO4LINUX_MAJOR):
        raise CameraError(f"{path} is not a camera", hint="`capture-app cameras` lists the cameras there are")
    for _ in range(_WAKING_TRIES):
        try:
            return VideoDevice(path)
        except OSError as error:
            if error.errno != errno.EBUSY:
                raise
            # A USB camera that sleeps answers so while its hub wakes up; uvcvideo never means "in use" here.
            time.sleep(_WAKING_PAUSE_S)
    return VideoDevice(path)
