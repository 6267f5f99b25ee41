"""A moving object is followed through space, by the time of each frame, or it is said why not."""

import numpy as np
import pytest

from reconstruction.methods.trajectory.moving_point import find_moving_points
from reconstruction.scene.moving_pixels import median_background


def test_the_middle_of_a_region_that_is_cut_off_is_not_taken() -> None:
    background = np.full((120, 160), 40, np.uint8)
    whole, cut = background.copy(), background.copy()
    whole[50:61, 70:81] = 200
    cut[50:61, 70:160] = 200
    found, *others = find_moving_points([whole, cut, background], background, 9)
    assert found == pytest.approx([75.0, 55.0], abs=0.05)
    assert others == [None, None]


@pytest.mark.parametrize("px_a_frame", [6, 1])
def test_an_object_that_the_background_shows_is_not_taken_for_another_place(px_a_frame: int) -> None:
    images = []
    for k in range(40):
        image = np.full((120, 320), 40, np.uint8)
        image[50:81, 20 + px_a_frame * k : 51 + px_a_frame * k] = 200
        images.append(image)
    points = find_moving_points(images, median_background(images), len(images))
    off = [abs(point[0] - 35 - px_a_frame * k) for k, point in enumerate(points) if point is not None]
    assert max(off, default=0) < 0.1
    assert len(off) == (40 if px_a_frame == 6 else 0)
