"""Small cameras for tests of what they see of each other, and their pictures of a plane."""

import cv2
import numpy as np

from reconstruction.common.geometry import Array, View
from reconstruction.depth.calibrated_image import CalibratedImage
from reconstruction.depth.view_choice import choose_source_views, grid_points
from tests.unit.reconstruction.conftest import texture

WIDTH, HEIGHT, FOCAL = 128, 96, 110.0
MATRIX = np.array([[FOCAL, 0, 63.5], [0, FOCAL, 47.5], [0, 0, 1.0]])
PLACES = {"left": (-0.15, 0.0), "middle": (0.0, 0.02), "right": (0.15, 0.0)}
PAINT = texture(3).astype(np.float32)
SLOPE = np.array([0.35, -0.5])


def view_at(x: float, y: float = 0.0, z: float = 0.0) -> View:
    """A camera that looks along z."""
    return View(WIDTH, HEIGHT, MATRIX, np.zeros(5), np.eye(3), -np.array([x, y, z]))


def choose_by_depth(views: dict[str, View]) -> dict[str, tuple[str, ...]]:
    """The sources for a scene 2 m away."""
    return choose_source_views(views, {name: grid_points(view, 2.0) for name, view in views.items()})


def photo_of(
    view: View, slope: Array = SLOPE, seed: int = 0, gain: float = 1.0
) -> tuple[CalibratedImage, Array]:
    """The plane z = 2 + slope . (x, y), textured, and its depth in the picture."""
    rays = view.rays(view.grid())
    reach = (2 + view.centre[:2] @ slope) / (1 - rays[:, :2] @ slope)
    at = (view.centre[:2] + reach[:, None] * rays[:, :2]) * 150 + 250
    shape = (view.height, view.width)
    xs, ys = (np.mod(at[:, i], 511).astype(np.float32).reshape(shape) for i in (0, 1))
    image = gain * cv2.remap(PAINT, xs, ys, cv2.INTER_LINEAR)
    image += np.random.default_rng(seed).normal(0, 1, shape).astype(np.float32)
    return CalibratedImage(view, np.asarray(image, np.float32), 5, 9.0), reach.reshape(shape)
