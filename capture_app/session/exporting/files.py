"""Image files and masks of moving objects for other programs, copied unchanged where the format allows."""

import os
from pathlib import Path

import numpy as np

from capture_app.common.errors import BadInputError, IncompleteError
from capture_app.session.exporting.exported_burst import ExportedBurst
from capture_app.session.files.untrusted_files import read_regular
from capture_app.session.format.lens import Picture, Redraw
from capture_app.session.format.manifest import FrameRecord, ImageRecord
from capture_app.session.reading.decoding import decode_image, encode_image

_SAME = {".jpeg": ".jpg", ".mjpeg": ".jpg", ".tif": ".tiff"}


def suffix_for(burst: ExportedBurst, images: list[ImageRecord]) -> str:
    """Return the file suffix for all of these images: their own, or .png if they differ."""
    endings = {_ending(burst, image) for image in images}
    return endings.pop() if len(endings) == 1 else ".png"


def place(
    burst: ExportedBurst, image: ImageRecord, folder: Path, file: str, redraw: Redraw | None = None
) -> None:
    """Write an image into a folder: its own bytes, or its pixels as PNG if the suffix requires it.

    A redrawn image is JPEG of quality 98, or PNG. Raises as `ExportedBurst.load` does if the file is not the
    image that was saved.
    """
    data, pixels = burst.load(image)
    target = folder / file
    target.parent.mkdir(parents=True, exist_ok=True)
    if redraw is not None:
        target.write_bytes(encode_image(redraw(pixels), target.suffix, quality=98))
    elif _ending(burst, image) != target.suffix:
        target.write_bytes(encode_image(pixels, target.suffix, quality=98))
    elif burst.options.link and not isinstance(image, FrameRecord):
        os.link(burst.session.image_file(image).resolve(), target)
    else:
        target.write_bytes(data)


def jpeg_or_png(burst: ExportedBurst, image: ImageRecord) -> tuple[bytes, str]:
    """Return an image's own bytes if they are JPEG or PNG, otherwise its pixels as PNG; and `jpeg` or `png`.

    Raises as `ExportedBurst.load` does.
    """
    data, pixels = burst.load(image)
    kind = {".jpg": "jpeg", ".png": "png"}.get(_ending(burst, image))
    return (data, kind) if kind else (encode_image(pixels, ".png"), "png")


def _ending(burst: ExportedBurst, image: ImageRecord) -> str:
    ending = burst.session.image_file(image).suffix.lower()
    return _SAME.get(ending, ending)


def mask_path(folder: Path, camera: str, instant: int) -> Path:
    """Return the path of an image's mask in a folder of masks."""
    return folder / camera / f"{instant:06d}.png"


def write_mask(
    burst: ExportedBurst,
    masks: Path | None,
    image: ImageRecord,
    target: Path,
    *,
    movers: int,
    redraw: Redraw | None = None,
) -> None:
    """Write an image's mask from the folder `masks`, if given; `movers` (0 or 255) marks moving regions.

    Raises IncompleteError if the folder lacks it, BadInputError if its size differs from the image's.
    """
    import cv2

    if masks is None:
        return
    path = mask_path(masks, image.camera, image.instant)
    if not path.is_file():
        raise IncompleteError(f"{path} is missing", hint="reconstruct movers makes masks of all images")
    width, height = burst.size(image.camera)
    mask = decode_image(read_regular(path), colour=True, max_pixels=width * height)
    if mask is None or mask.shape[:2] != (height, width):
        raise BadInputError(
            f"{path} is not a picture of {width}x{height} pixels",
            hint="reconstruct movers makes masks of the images' size",
        )
    white: Picture = np.where(cv2.cvtColor(mask, cv2.COLOR_BGR2GRAY) > 127, 255, 0).astype(np.uint8)
    if redraw:
        white = np.where(redraw(white) > 127, 255, 0).astype(np.uint8)
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(encode_image(white if movers else 255 - white, ".png"))
