"""Rods of a few pixels before a textured wall: they are in the range of depth, and stay in front."""

import cv2
import numpy as np
import pytest

from reconstruction.common.geometry import Array, View
from reconstruction.depth.calibrated_image import CalibratedImage, SourceView
from reconstruction.depth.plane_sweep import Surface
from reconstruction.depth.rough_scene import find_rough_scene
from reconstruction.methods.multiview.edge_sharpening import sharpen_edges

WALL_M, RODS_M, ROD_PX = 4.3, 2.6, 3
WIDTH, HEIGHT, FOCAL = 480, 80, 390.0
MATRIX = np.array([[FOCAL, 0, 239.5], [0, FOCAL, 39.5], [0, 0, 1.0]])
PAINT = cv2.GaussianBlur(np.random.default_rng(5).normal(128, 170, (HEIGHT, 640)), (0, 0), 1.2)
SHADES = 240.0, 90.0, 150.0
CAMERAS = {"left": -0.2, "middle": 0.0, "right": 0.2}


def photo(centre_x: float, *, rods: bool) -> tuple[CalibratedImage, Array]:
    """A wall with upright rods before it, as a camera sees them, and where the rods are (bool)."""
    view = View(WIDTH, HEIGHT, MATRIX, np.zeros(5), np.eye(3), -np.array([centre_x, 0, 0]))
    x, y = (axis.astype(np.float32) for axis in np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)))
    at = np.float32(centre_x * FOCAL / WALL_M) + x + 10, y
    grey = cv2.remap(PAINT.astype(np.float32), *at, cv2.INTER_LINEAR)
    there = np.zeros(grey.shape, bool)
    for number, shade in enumerate(SHADES if rods else ()):
        left = round(90 + 80 * number - centre_x * FOCAL / RODS_M)
        there[:, left : left + ROD_PX] = True
        grey[:, left : left + ROD_PX] = shade
    grey += np.random.default_rng(len(SHADES)).normal(0, 1, grey.shape).astype(np.float32)
    return CalibratedImage(view, grey, 7, 9.0), there


@pytest.mark.parametrize("rods", [True, False])
def test_a_range_of_depth_contains_rods_that_small_images_do_not_show(rods: bool) -> None:
    found = find_rough_scene({name: photo(x, rods=rods)[0] for name, x in CAMERAS.items()})
    for nearest, farthest in found.depth_ranges.values():
        assert (nearest < RODS_M) == rods
        assert nearest > RODS_M / 1.3
        assert farthest > WALL_M


def test_rods_stay_in_front_where_their_pixels_match_there() -> None:
    shots = [photo(x, rods=True) for x in (0.0, -0.2, 0.2)]
    there = shots[0][1]
    wide = cv2.dilate(there.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    level = np.where(wide, 1 / RODS_M, 1 / WALL_M).astype(np.float32)
    flat = np.zeros_like(level)
    views = [SourceView(shots[0][0], other) for other, _ in shots[1:]]
    found = sharpen_edges(Surface(level, flat, flat, flat), views, flat == 0).inverse_depth
    near = found > 1 / WALL_M + 0.01
    assert near[there].mean() > 0.9
    assert near[wide & ~there].mean() < 0.3
