"""A wall that is too faint for the rough scene's points: depth is looked for there all the same."""

import cv2
import numpy as np

from reconstruction.common.geometry import View
from reconstruction.depth.calibrated_image import CalibratedImage
from reconstruction.depth.rough_scene import find_rough_scene

BOARD_M, WALL_M = 2.6, 4.6
WIDTH, HEIGHT, FOCAL = 240, 100, 200.0
MATRIX = np.array([[FOCAL, 0, 119.5], [0, FOCAL, 49.5], [0, 0, 1.0]])
PAINT = cv2.GaussianBlur(np.random.default_rng(5).normal(128, 170, (HEIGHT, 400)), (0, 0), 1.2)


def photo(number: int, centre_x: float) -> CalibratedImage:
    """A painted board before a grey wall, as a camera sees them."""
    view = View(WIDTH, HEIGHT, MATRIX, np.zeros(5), np.eye(3), -np.array([centre_x, 0, 0]))
    grey = np.full((HEIGHT, WIDTH), 120, np.float32)
    left = round(60 - centre_x * FOCAL / BOARD_M)
    grey[20:, left : left + 120] = PAINT[20:, :120]
    grey += np.random.default_rng(number).normal(0, 1, grey.shape).astype(np.float32)
    return CalibratedImage(view, grey, 7, 9.0)


def test_a_wall_behind_the_points_is_in_the_range_of_depth() -> None:
    places = {"left": -0.2, "middle": 0.0, "right": 0.2}
    scene = find_rough_scene({name: photo(k, x) for k, (name, x) in enumerate(places.items())})
    assert scene.depth_ranges.keys() == places.keys()
    for name, (nearest, farthest) in scene.depth_ranges.items():
        points = scene.points[name]
        assert abs(np.median(points[:, 2]) - BOARD_M) < 0.15
        assert nearest < BOARD_M
        assert WALL_M < farthest < 2 * WALL_M
