"""Whether a burst will find room, on the leader's disk and in the nodes' spools."""

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

from capture_app.errors import DiskFullError
from capture_app.node.messages import NodeSpace
from capture_app.node.snapshots import cameras_here
from capture_app.sync.leader import ClientView

GUESSED_PIXELS_PER_BYTE = 4
"""Of a camera's JPEG, before any of its images is known."""
SPARE_BYTES = 2 << 20
_MARGIN = 1.1


def guessed_image_bytes(width: int, height: int) -> int:
    """The likely size of an image of so many pixels, in bytes."""
    return width * height // GUESSED_PIXELS_PER_BYTE


def expected_image_bytes(views: Sequence[ClientView], known: Mapping[str, int]) -> dict[str, int]:
    """The likely size in bytes of an image of each camera that is here, from those that came before."""
    return {
        view.name: known.get(view.name) or guessed_image_bytes(view.camera.width, view.camera.height)
        for view in cameras_here(views)
    }


def free_bytes(folder: Path) -> int:
    """What is free for this user on the disk of a folder, which need not be there yet, in bytes."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return shutil.disk_usage(folder).free


def check_room(
    root: Path, image_bytes: Mapping[str, int], frames: int, spools: Mapping[str, NodeSpace]
) -> None:
    """Check that a burst fits: `image_bytes` by camera, `frames` of each, `spools` as nodes told them.

    Raises DiskFullError that says where there is too little room.
    """
    needed = int(_MARGIN * frames * sum(image_bytes.values())) + SPARE_BYTES
    free = free_bytes(root)
    if needed > free:
        raise DiskFullError(
            f"the burst may need {_mb(needed)} and {root} has {_mb(free)} free",
            hint="make room, or take fewer frames",
        )
    for name, size in image_bytes.items():
        spool = spools.get(name)
        needed = int(_MARGIN * frames * size)
        if spool is not None and needed > spool.free_bytes:
            raise DiskFullError(
                f"{name} may need {_mb(needed)} and has {_mb(spool.free_bytes)} free in {spool.spool}",
                hint="make room on that node, or take fewer frames",
            )


def _mb(size: int) -> str:
    return f"{size / 1e6:,.1f} MB"
