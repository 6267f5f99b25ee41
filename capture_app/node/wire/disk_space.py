"""How much a disk has left, and how much a burst will want of it."""

import shutil
from pathlib import Path

GUESSED_PIXELS_PER_BYTE = 4
"""Of a camera's JPEG, before any of its images is known."""
SPARE_BYTES = 2 << 20
MARGIN = 1.1


def guessed_image_bytes(width: int, height: int) -> int:
    """The likely size of an image of so many pixels, in bytes."""
    return width * height // GUESSED_PIXELS_PER_BYTE


def free_bytes(folder: Path) -> int:
    """What is free for this user on the disk of a folder, which need not be there yet, in bytes."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return shutil.disk_usage(folder).free
