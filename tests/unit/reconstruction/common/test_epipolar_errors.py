"""Distances of matched pixels from the epipolar geometry of two views."""

import numpy as np
import pytest

from reconstruction.common.geometry import epipolar_errors_px
from tests.unit.reconstruction.conftest import make_view

AT_A, AT_B = np.array([[[100.0, 80.0], [150.0, 90.0]], [[90.0, 82.0], [120.0, 90.0]]])


def test_distances_from_epipolar_lines() -> None:
    """Of two cameras side by side, half the difference of the rows, in both pictures."""
    a, b = make_view((-0.1, 0.0, 0.0)), make_view((0.1, 0.0, 0.0))
    errors = epipolar_errors_px(a, b, AT_A, AT_B)
    assert np.abs(errors) == pytest.approx([2 / np.sqrt(2), 0.0], rel=0.01)


def test_cameras_at_one_place_have_no_epipolar_lines() -> None:
    a, b = make_view((0.0, 0.0, 0.0)), make_view((0.0, 0.0, 0.0), yaw=2.0)
    assert list(epipolar_errors_px(a, b, AT_A, AT_B)) == [0.0, 0.0]
