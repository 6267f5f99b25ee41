"""How much a disk has left, and how much a burst will want of it."""

import shutil
from pathlib import Path

SPARE_BYTES = 2 << 20


def free_bytes(folder: Path) -> int:
    """What is free for this user on the disk of a folder, which need not be there yet, in bytes."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return shutil.disk_usage(folder).free
