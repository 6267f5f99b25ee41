"""What cameras see of the jumping child without a lamp, as linear light."""

from functools import cache

import cv2
import numpy as np

from capture_app.simulation.rendering import scene
from reconstruction.common.geometry import Array
from tests.reconstruction.time_offsets.blinking import PERIOD_NS

IMAGES = 30
SIZE = 160, 480
"""Width and height: all rows, and no more columns than it takes."""


@cache
def scene_light(view: str) -> tuple[Array, ...]:
    """A second of a view's motion, 0 to 1."""
    stage = scene.load("studio").draft(0.5)
    return tuple(
        _light(stage.render(view, 10_000_000_000 + k * PERIOD_NS, 4_000_000, 0, seed=k))
        for k in range(IMAGES)
    )


def _light(image: Array) -> Array:
    """Linear, of a picture in sRGB."""
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    share = cv2.resize(grey, SIZE, interpolation=cv2.INTER_AREA).astype(np.float64) / 255
    return np.asarray(np.where(share < 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4))
