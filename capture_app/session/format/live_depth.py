"""Messages to and from `reconstruct live`, which computes depth of previews of one instant.

Each has its length in front: on stdin first a `LiveCameras`, then `InstantImages`, each answered on stdout by
a `DepthPreview` before the next is sent.
"""

import struct

import msgspec
from msgspec import Struct

from capture_app.common.camera_facts import CameraFacts

WIDTH_PX = 320
"""Width of the previews and of their depth."""
LENGTH = struct.Struct(">I")


class LiveCameras(Struct, frozen=True):
    """Cameras of a rig, and the folder of its sessions, some of which may be calibrated."""

    cameras: dict[str, CameraFacts]
    sessions_folder: str


class InstantImages(Struct, frozen=True):
    """JPEGs of cameras at one instant (leader time, ns), and the camera whose depth is requested."""

    instant_ns: int
    camera: str
    jpegs: dict[str, bytes]


class DepthPreview(Struct, frozen=True):
    """Depth of a camera at one instant as a coloured JPEG, empty if there is none; near is bright."""

    instant_ns: int
    camera: str
    jpeg: bytes = b""
    moving_confirmed: float | None = None
    """Fraction of moving pixels whose depth the other cameras confirm; None if few pixels move."""
    problem: str = ""
    """Reason why there is no depth, and a remedy."""
    late_ns: int | None = None
    """Age of the instant at receipt, added by the receiver; None if the leader's time is unknown."""


def pack(message: Struct) -> bytes:
    """Return a message with its length in front."""
    data = msgspec.msgpack.encode(message)
    return LENGTH.pack(len(data)) + data
