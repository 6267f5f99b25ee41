"""Reading and writing of image files, raising the errors that OpenCV does not raise."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from capture_app.common.errors import BadInputError, reading
from capture_app.session.reading.decoding import picture_size, size_of
from reconstruction.common.geometry import Array
from reconstruction.common.memory import MEMORY, gigabytes, memory_budget
from reconstruction.common.native_libraries import opencv_calls, silenced_output

FAST_PNG = (cv2.IMWRITE_PNG_COMPRESSION, 0)
"""PNG options for images that are read once: a third larger, and written and read in a third of the time."""
JPEG_QUALITY = 92


MIN_SIDE_PX, MAX_ASPECT = 16, 40
"""Minimum side and maximum aspect ratio; narrower images have nothing to match in another."""
DECODED_FRACTION = 0.25
"""Fraction of the memory budget that one decoded image may take."""
REDUCTIONS = {8: cv2.IMREAD_REDUCED_COLOR_8, 4: cv2.IMREAD_REDUCED_COLOR_4, 2: cv2.IMREAD_REDUCED_COLOR_2}


def read_image(path: Path, size: tuple[int, int] | None = None, data: bytes | None = None) -> Array:
    """Read an image, uint8 height x width x 3, BGR, reduced to `size` (width, height) if given.

    `data` are its bytes, if they are already read or are a part of the file.

    Raises:
        BadInputError: it is not an image, its format is not supported, or it is too large to decode.
    """
    found = image_size(path, data)
    reduction = 1
    if size is not None:
        ratio = min(max(found) / max(size), min(found) / min(size))
        reduction = max([1, *(factor for factor in REDUCTIONS if factor <= ratio)])
    # Only JPEG is decoded at a smaller size; other formats are decoded whole.
    is_jpeg = path.suffix.lower() in (".jpg", ".jpeg", ".mjpeg")
    decoded = 3 * found[0] * found[1] / (reduction**2 if is_jpeg else 1)
    if decoded > DECODED_FRACTION * memory_budget().limit_bytes:
        raise BadInputError(
            f"{path} is {found[0]}x{found[1]} pixels: decoded it takes {gigabytes(decoded)} of memory, "
            f"and a picture may take {gigabytes(DECODED_FRACTION * memory_budget().limit_bytes)}",
            hint=f"make it smaller, or give it more: {MEMORY}=8GB in the environment",
        )
    # Decoders write warnings about broken files to stderr.
    with silenced_output(), opencv_calls(f"decoding {path.name}"):
        how = REDUCTIONS.get(reduction, cv2.IMREAD_COLOR) | cv2.IMREAD_IGNORE_ORIENTATION
        raw = np.fromfile(path, np.uint8) if data is None else np.frombuffer(data, np.uint8)
        image = cv2.imdecode(raw, how)
        if image is not None and size is not None and _same_shape(image.shape[1::-1], size):
            image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    if image is None:
        raise BadInputError(
            f"{path} is not an image, or its format is not supported", hint="convert it to JPEG or PNG"
        )
    return np.asarray(image, np.uint8)


def read_small_image(path: Path, longest_px: int) -> Array:
    """Read an image as `read_image` does, reduced if a side is longer than `longest_px`.

    Raises:
        BadInputError: as `read_image`.
    """
    width, height = image_size(path)
    scale = min(1.0, longest_px / max(width, height))
    size = max(1, round(width * scale)), max(1, round(height * scale))
    return np.asarray(cv2.resize(read_image(path, size), size, interpolation=cv2.INTER_AREA))


def _same_shape(a: Sequence[int], b: Sequence[int]) -> bool:
    """Return whether two sizes have about the same aspect ratio."""
    return abs(a[0] * b[1] - a[1] * b[0]) < 0.1 * a[0] * b[1]


def image_size(path: Path, data: bytes | None = None) -> tuple[int, int]:
    """Return an image's width and height from its file's header, before any EXIF orientation, px.

    `data` is as in `read_image`.

    Raises:
        BadInputError: it is not an image, its format is not supported, or its shape is unusable.
    """
    with reading(path):
        size = picture_size(path) if data is None else size_of(data)
    if size is None:
        raise BadInputError(
            f"{path} is not an image, or its format is not supported", hint="convert it to JPEG or PNG"
        )
    refuse_odd_shape(str(path), *size)
    return size


def refuse_odd_shape(what: str, width: int, height: int) -> None:
    """Raise BadInputError for images that are too small or narrow to detect anything in."""
    if min(width, height) < MIN_SIDE_PX or max(width, height) > MAX_ASPECT * min(width, height):
        raise BadInputError(
            f"{what} is {width}x{height} pixels: too small or too narrow to work with",
            hint=f"it takes {MIN_SIDE_PX} pixels across and down, and no side {MAX_ASPECT} times the other",
        )


def write_image(path: Path, image: Array, parameters: Sequence[int] = ()) -> None:
    """Write an image in the format of the file's suffix; `parameters` are OpenCV's.

    Raises:
        OSError: it cannot be written. `cv2.imwrite` does not report a full disk.
    """
    path.write_bytes(cv2.imencode(path.suffix, image, parameters)[1].tobytes())


def save_picture(folder: Path, name: str, picture: Array, *, quality: int = JPEG_QUALITY) -> str:
    """Write a picture into folder/pictures and return its relative path. `quality` is for JPEG."""
    target = folder / "pictures" / name
    target.parent.mkdir(parents=True, exist_ok=True)
    write_image(target, picture, [cv2.IMWRITE_JPEG_QUALITY, quality] if target.suffix == ".jpg" else [])
    return f"pictures/{name}"
