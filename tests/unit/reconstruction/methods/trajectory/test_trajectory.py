"""A moving object is followed through space, by the time of each frame, or it is said why not."""

import numpy as np
import pytest

from reconstruction.methods.trajectory.moving_point import find_moving_point


def test_the_middle_of_a_region_that_is_cut_off_is_not_taken() -> None:
    background = np.full((120, 160), 40, np.uint8)
    image = background.copy()
    image[50:61, 70:81] = 200
    found = find_moving_point(image, background)
    assert found == pytest.approx([75.0, 55.0], abs=0.05)
    image[50:61, 70:160] = 200
    assert find_moving_point(image, background) is None
    assert find_moving_point(background, background) is None
