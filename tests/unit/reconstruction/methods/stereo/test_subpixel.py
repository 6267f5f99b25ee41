"""Disparities between whole pixels are found, also where the other picture is darker, and edges stay."""

import cv2
import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.methods.stereo.matching import refine_disparity

EDGE = 100
NEAR, FAR = 12.3, 4.6


def textured_pair() -> tuple[Array, Array, Array]:
    """Two grey pictures (float32) and the true disparity: a near half at the left, a far one at the right."""
    rng = np.random.default_rng(5)
    other = cv2.GaussianBlur(rng.uniform(0, 255, (90, 240)).astype(np.float32), (0, 0), 1.2)
    truth = np.full(other.shape, FAR, np.float32)
    truth[:, :EDGE] = NEAR
    ys, xs = np.indices(other.shape, np.float32)
    return cv2.remap(other, xs - truth, ys, cv2.INTER_CUBIC), other, truth


def test_whole_pixels_become_parts_of_them() -> None:
    reference, other, truth = textured_pair()
    for picture in (other, other - 30):
        found = refine_disparity(reference, picture, np.round(truth))
        error = np.abs(found - truth)[10:-10, 25:-15]
        assert np.median(error) < 0.06
        assert np.median(np.abs(np.round(truth) - truth)) > 0.25


def test_an_edge_of_depth_stays_sharp_and_a_hole_a_hole() -> None:
    reference, other, truth = textured_pair()
    holed = np.round(truth)
    holed[40:60, 60:150] = np.nan
    found = refine_disparity(reference, other, holed)
    assert (np.isnan(found) == np.isnan(holed)).all()
    beside = np.s_[10:-10, EDGE - 3 : EDGE + 3]
    assert np.nanmax(np.abs(found - truth)[beside]) < 0.8
