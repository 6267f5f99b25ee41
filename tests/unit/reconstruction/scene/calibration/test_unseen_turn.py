"""What depth from two cameras is off by where one is turned sideways, which no point shows."""

import numpy as np
import pytest

from reconstruction.common.geometry import Array
from reconstruction.scene.calibration.consistency import ROTATION_PX, describe_sideways_error, turn_error
from tests.unit.reconstruction.depth.small_views import FOCAL, view_at


@pytest.mark.parametrize("z", [0.0, 0.1])
def test_it_is_the_error_of_triangulated_depth(z: float) -> None:
    first, second, depth = view_at(0.0), view_at(0.3, 0.0, z), 3.0
    said = turn_error(first, second, np.array([[0.0, depth]]))
    # The turned camera's ray to the same pixel meets the first one's elsewhere: in the plane, two lines.
    angle = ROTATION_PX / FOCAL
    seen = np.arctan2(-second.centre[0], depth - second.centre[2])
    met = second.centre[2] - second.centre[0] / np.tan(seen + angle)
    assert said == pytest.approx(abs(met / depth - 1), rel=0.1)


def test_nothing_is_said_without_depth_and_no_line_between_the_cameras() -> None:
    nothing: Array = np.zeros((2, 2))
    assert turn_error(view_at(0.0), view_at(0.3), nothing) is None
    assert turn_error(view_at(0.0), view_at(0.0, 0.0, 1.0), nothing + 1) is None


def test_it_is_said_in_percent_of_depth() -> None:
    assert describe_sideways_error(0.0244) == (
        "two cameras do not show a turn sideways: 0.5 px of it is 2.4 % of depth here"
    )
