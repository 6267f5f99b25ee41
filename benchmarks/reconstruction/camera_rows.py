"""Real rows of cameras with true depth: folders in the layout of Middlebury 2005 and 2006, seven views each.

Source: https://vision.middlebury.edu/stereo/data (Scharstein and Pal 2007, Hirschmueller and Scharstein
2007), the downloads of seven views, each unpacked into its folder. The truth is by structured light.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from benchmarks.reconstruction.multiview_scenes import Condition, Rendered
from capture_app.common.errors import BadInputError
from reconstruction.common.geometry import Array, View

FULL_HEIGHT, FULL_FOCAL_PX = 1110, 3740.0
"""Of the full-size images. Half and third sizes give disparities in the full size's pixels as well."""
STEP_M = 0.04
"""Distance between neighbouring views."""
TRUE_VIEWS, TRUE_STEPS = (1, 5), 4
"""The views with a disparity to each other, which are so many steps apart."""
MIDDLE = 3


@dataclass(frozen=True)
class _Scale:
    """Size of the images, and what turns their disparities into depth."""

    width: int
    height: int
    factor: float
    """Pixels of the full size by one of theirs."""
    min_disparity_px: float
    """What was cut off all disparities, full size."""

    def view(self, number: int) -> View:
        focal = FULL_FOCAL_PX / self.factor
        shift = self.min_disparity_px / self.factor * (number - MIDDLE) / TRUE_STEPS
        middle = (self.width - 1) / 2 + shift, (self.height - 1) / 2
        matrix = np.array([[focal, 0, middle[0]], [0, focal, middle[1]], [0, 0, 1]])
        translation = np.array([-STEP_M * (number - MIDDLE), 0, 0])
        return View(self.width, self.height, matrix, np.zeros(5), np.eye(3), translation)

    def depth(self, disparity: Array) -> Array:
        """Return depth (m, 0 = unknown) of a disparity image (0 = unknown)."""
        depth = FULL_FOCAL_PX * STEP_M * TRUE_STEPS / (disparity.astype(float) + self.min_disparity_px)
        return np.where(disparity > 0, depth, 0).astype(np.float32)


def read_row(folder: Path) -> Rendered:
    """Read the views of a folder, and the true depth of two of them.

    Raises:
        BadInputError: views or disparities are missing, or do not fit together.
    """
    pictures = _read(folder, "view{}.png", range(7), cv2.IMREAD_COLOR)
    disparities = _read(folder, "disp{}.png", TRUE_VIEWS, cv2.IMREAD_GRAYSCALE)
    shapes = {image.shape[:2] for image in [*pictures.values(), *disparities.values()]}
    if len(pictures) < 3 or len(disparities) < len(TRUE_VIEWS) or len(shapes) > 1:
        raise BadInputError(
            f"{folder} is not a row of cameras with true depth",
            hint="it needs view0.png to view6.png, disp1.png, disp5.png and dmin.txt, all images of one size",
        )
    try:
        minimum = float((folder / "dmin.txt").read_text())
    except (OSError, ValueError) as error:
        raise BadInputError(f"{folder / 'dmin.txt'} does not hold the smallest disparity: {error}") from error
    ((height, width),) = shapes
    scale = _Scale(width, height, round(FULL_HEIGHT / height), minimum)
    empty = np.zeros((height, width), np.float32)
    shown = Condition(
        {f"view{number}": picture for number, picture in pictures.items()},
        {f"view{n}": scale.depth(disparities[n]) if n in disparities else empty for n in pictures},
        {f"view{number}": empty.astype(bool) for number in pictures},
    )
    views = {f"view{number}": scale.view(number) for number in pictures}
    return Rendered(f"{folder.resolve().name} {width}x{height} (real)", views, shown, shown)


def _read(folder: Path, name: str, numbers: Iterable[int], flags: int) -> dict[int, Array]:
    found = {number: cv2.imread(str(folder / name.format(number)), flags) for number in numbers}
    return {number: image for number, image in found.items() if image is not None}
