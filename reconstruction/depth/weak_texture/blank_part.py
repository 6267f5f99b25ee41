"""What a picture shows where its windows hold hardly more than noise, in a small picture of its own."""

from dataclasses import dataclass

import cv2
import numpy as np

from reconstruction.common.geometry import Array, resize_view
from reconstruction.depth.calibrated_image import CalibratedImage

MAX_WIDTH_PX = 160
MAX_SCALE = 0.25
"""Of the small pictures: a pixel is the mean of 16 or more, and the less noisy."""
WINDOW = 7
"""Side of the window that is matched in them, px."""
NOISY = 1.25
"""A window is blank if its deviation, squared, is less than so many times that of noise alone."""
MIN_BLANK = 0.3
"""Share of a small picture's pixel that must be blank."""
SAME_SHADE = 6.0
"""Deviations of the picture's noise by which neighbours differ that are taken for one shade."""
REACH_PX = 4
MIDDLE = 128.0


@dataclass(frozen=True, eq=False)
class BlankPart:
    """The blank part of a picture: its faint texture alone, without edges, shades and all that is not blank.

    Matched by windows of `WINDOW` px, far wider than the picture's own ones: they see through the noise, and
    know nothing of a rod or a leaf before the wall.
    """

    image: CalibratedImage
    """The texture around `MIDDLE`; `MIDDLE` itself where nothing is blank."""
    shade: Array
    """Brightness (grey levels), float32 of the small picture's size."""
    there: Array
    """Where the small picture is blank (bool)."""
    mask: Array
    """Where the whole picture is blank (bool), of its own size."""


def extract_blank_part(image: CalibratedImage) -> BlankPart:
    """The blank part of a picture."""
    mask = image.deviation**2 < NOISY * image.noise
    view = image.view
    scale = min(MAX_SCALE, MAX_WIDTH_PX / view.width)
    small = resize_view(view, round(view.width * scale), round(view.height * scale))
    size = small.width, small.height
    weight = mask.astype(np.float32)
    share = cv2.resize(weight, size, interpolation=cv2.INTER_AREA)
    shade = cv2.resize(weight * image.grey, size, interpolation=cv2.INTER_AREA) / np.maximum(share, 1e-3)
    there = share > MIN_BLANK
    # The bilateral filter takes nothing from what is so far from every shade.
    outside = np.where(there, shade, np.float32(-1e4)).astype(np.float32)
    shades = SAME_SHADE * float(np.sqrt(image.noise)) / 3
    around = cv2.bilateralFilter(outside, 2 * REACH_PX + 1, shades, 2 * REACH_PX)
    texture = np.where(there, shade - around, 0) + np.float32(MIDDLE)
    averaged = view.width * view.height / (small.width * small.height)
    part = CalibratedImage(small, texture.astype(np.float32), WINDOW, image.noise / averaged)
    return BlankPart(part, shade, there, mask)
