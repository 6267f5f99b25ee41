"""True depth in the unit of a calibration without a metric scale."""

import numpy as np
import pytest

from reconstruction.method.truth import true_depth_in_unit

TRUTH = np.array([[2.0, 4.0], [0.0, 5.0]])
STILL = np.array([[3.0, 6.0], [8.0, 0.0]])
"""Depth of the same pixels, 1.5 units a metre; the last is unknown."""
STATIC = np.array([[True, True], [True, True]])


def test_still_pixels_give_the_scale() -> None:
    found = true_depth_in_unit(TRUTH, "sfm", STILL, STATIC)
    assert found == pytest.approx(np.array([[3.0, 6.0], [np.nan, 7.5]]), nan_ok=True)


def test_metres_stay_and_no_still_pixel_gives_nothing() -> None:
    assert true_depth_in_unit(TRUTH, "m", STILL, STATIC) == pytest.approx(
        np.array([[2.0, 4.0], [np.nan, 5.0]]), nan_ok=True
    )
    assert true_depth_in_unit(TRUTH, "sfm", STILL, ~STATIC) is None
