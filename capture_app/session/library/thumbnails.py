"""Thumbnails of images on disk, cached in a folder: decoding a full image takes much longer."""

import hashlib
import os
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from capture_app.session.reading.decoding import decode_image, encode_image
from capture_app.session.reading.sheet_pictures import fit

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

WIDTH_PX = 160
"""Width of the thumbnails."""
MAX_BYTES = 1 << 26
"""Number of bytes read of an image, or of a video for its first frame."""
MAX_FILES = 4000
"""Maximum number of cached thumbnails, about 20 MB; above it the oldest half is removed."""


def load_thumbnail(folder: Path, image: Path) -> "NDArray[np.uint8] | None":
    """Return a thumbnail (height x width x BGR, `WIDTH_PX` wide), cached in `folder`; None if unreadable.

    May be called from any thread. Blocks on the disk.
    """
    try:
        stat = image.stat()
    except OSError:
        return None
    key = f"{image.resolve()}\0{stat.st_mtime_ns}\0{stat.st_size}"
    cached = folder / f"{hashlib.sha256(os.fsencode(key)).hexdigest()[:32]}.jpg"
    small = _decode(cached)
    if small is not None:
        return small
    large = _decode(image)
    return None if large is None else _keep(cached, fit(large, WIDTH_PX, WIDTH_PX * large.shape[0]))


def _keep(path: Path, small: "NDArray[np.uint8]") -> "NDArray[np.uint8]":
    """Cache a thumbnail, and return it as it will be read back after lossy coding."""
    coded = encode_image(small, quality=85)
    # A cache that cannot be written only costs time.
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        aside = path.with_suffix(f".{os.getpid()}.part")
        aside.write_bytes(coded)
        aside.replace(path)
        # Only one write in 256 checks whether there are too many.
        files = [] if int(path.name[:2], 16) else list(path.parent.glob("*.jpg"))
        files.sort(key=lambda file: file.stat().st_mtime_ns)
        for file in files[: len(files) // 2] if len(files) > MAX_FILES else ():
            file.unlink(missing_ok=True)
    cached = decode_image(coded, colour=True)
    return small if cached is None else cached


def _decode(path: Path) -> "NDArray[np.uint8] | None":
    try:
        with path.open("rb") as file:
            # The first frame of a video is a complete JPEG.
            return decode_image(file.read(MAX_BYTES), colour=True, min_width=WIDTH_PX)
    except OSError:
        return None
