"""Cameras of libcamera: finding and opening them."""

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from capture_app.cameras.base import Camera, CameraListing, in_node_clock
from capture_app.cameras.libcamera.camera import LibcameraCamera
from capture_app.cameras.libcamera.facts import KIND
from capture_app.cameras.libcamera.library import load_library
from capture_app.cameras.libcamera.mode import parse_options
from capture_app.cameras.system_packages import is_installed
from capture_app.clock import NodeClock
from capture_app.errors import NotAvailableError

CHARACTER_DEVICES = Path("/sys/dev/char")


def open_camera(device: str, options: Mapping[str, str], *, clock: NodeClock, name: str) -> Camera:
    """Open a camera by the library's id of it, or its number in the list.

    Options are width, height (pixels), fps, format, exposure-us and gain. Raises BadInputError for an option
    that cannot be read, CameraError where the camera is missing, busy or has no such mode, NotAvailableError
    where the library is missing or too old.
    """
    wishes = parse_options(options)
    return in_node_clock(LibcameraCamera(load_library(), device, wishes), clock)


def list_cameras() -> list[CameraListing]:
    """The library's cameras but for those that V4L2 drives as well; or why none of them can be used."""
    if not is_installed("libcamera"):
        return []
    try:
        library = load_library()
    except NotAvailableError as error:
        return [CameraListing(f"{KIND}:0", KIND, "", str(error), usable=False)]
    return list(_listings(library.cameras))


def _listings(cameras: list[Any]) -> Iterator[CameraListing]:
    for camera in cameras:
        properties = {control.name: value for control, value in camera.properties.items()}
        if _is_webcam(properties.get("SystemDevices", ())):
            continue
        size = properties.get("PixelArraySize")
        moved = any(control.name == "FrameDurationLimits" for control in camera.controls)
        detail = "moved by frame durations" if moved else "moved by restarts"
        sensor = f"sensor of {size.width}x{size.height}, " if size is not None else ""
        yield CameraListing(
            f"{KIND}:{camera.id}", KIND, str(properties.get("Model", camera.id)), sensor + detail
        )


def _is_webcam(devices: tuple[int, ...]) -> bool:
    """Whether a camera's device nodes are of a USB webcam, which is listed, and better driven, by V4L2."""
    nodes = (CHARACTER_DEVICES / f"{os.major(device)}:{os.minor(device)}" for device in devices)
    return any((node / "device" / "driver").resolve().name == "uvcvideo" for node in nodes)
