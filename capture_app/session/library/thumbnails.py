"""Small pictures of images on disk, kept in a cache folder: decoding a camera's image takes far longer."""

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
"""Width of the small pictures."""
MOST_BYTES = 1 << 26
"""The most that is read of an image, or of a video for its first frame."""
MOST_FILES = 4000
"""The most pictures that are kept, about 20 MB; beyond that the oldest half is removed."""


def load_thumbnail(folder: Path, image: Path) -> "NDArray[np.uint8] | None":
    """An image file `WIDTH_PX` wide, height x width x BGR, kept in a folder; None where it cannot be read.

    May be called from any thread, blocks on the disk.
    """
    try:
        stat = image.stat()
    except OSError:
        return None
    key = f"{image.resolve()}\0{stat.st_mtime_ns}\0{stat.st_size}"
    kept = folder / f"{hashlib.sha256(os.fsencode(key)).hexdigest()[:32]}.jpg"
    small = _decode(kept)
    if small is not None:
        return small
    large = _decode(image)
    return None if large is None else _keep(kept, fit(large, WIDTH_PX, WIDTH_PX * large.shape[0]))


def _keep(path: Path, small: "NDArray[np.uint8]") -> "NDArray[np.uint8]":
    """Keep it, and return it as it will be read again: coded with loss."""
    coded = encode_image(small, quality=85)
    # A cache that cannot be written costs time only.
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        aside = path.with_suffix(f".{os.getpid()}.part")
        aside.write_bytes(coded)
        aside.replace(path)
        # One in 256 looks whether there are too many.
        files = [] if int(path.name[:2], 16) else list(path.parent.glob("*.jpg"))
        files.sort(key=lambda file: file.stat().st_mtime_ns)
        for file in files[: len(files) // 2] if len(files) > MOST_FILES else ():
            file.unlink(missing_ok=True)
    kept = decode_image(coded, colour=True)
    return small if kept is None else kept


def _decode(path: Path) -> "NDArray[np.uint8] | None":
    try:
        with path.open("rb") as file:
            # Of a video the first frame, which is a whole JPEG.
            return decode_image(file.read(MOST_BYTES), colour=True, at_least=WIDTH_PX)
    except OSError:
        return None
