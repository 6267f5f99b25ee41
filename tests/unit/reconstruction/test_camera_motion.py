"""A camera that moves while it records is noticed by what should stand still."""

from collections.abc import Callable
from itertools import pairwise
from typing import cast

import numpy as np
import pytest

from capture_app.session.reading.reader import Session
from reconstruction.common.geometry import Array
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.moving_pixels import find_shifts, measure_camera_motion
from tests.unit.reconstruction.conftest import texture


def test_cameras_on_tripods_stand_still_however_much_moves_before_them(boards: Session) -> None:
    data = Dataset.open(boards.folder)
    for camera in data.cameras:
        found = measure_camera_motion(data, camera)
        assert found is not None
        still_fraction, *_ = found
        assert still_fraction > 0.6


class Wall:
    """A textured wall, and where a camera looks at it by instant, px."""

    def __init__(self, place: Callable[[int], int]) -> None:
        self.place = place

    def instants(self, *cameras: str) -> tuple[int, ...]:
        """Thirty instants."""
        return tuple(range(30))

    def grey(self, camera: str, instant: int) -> Array:
        """The part of the wall that is seen; a patch in the middle goes its own way."""
        left, wall = self.place(instant), texture(3)
        image = wall[100:250, left : left + 200].copy()
        image[40:110, 50:120] = wall[7 * instant : 7 * instant + 70, 300:370]
        return image


@pytest.mark.parametrize(
    ("place", "found"),
    [
        (lambda k: 100, []),
        (lambda k: 100 + 4 * (k >= 14), [(13, 14)]),
        (lambda k: 100 + 4 * (k >= 4) - 3 * (k >= 22), [(3, 4), (21, 22)]),
        (lambda k: 100 + 9 * (k in (15, 16)) + 4 * (k >= 17), [(14, 17)]),
    ],
)
def test_a_bumped_tripod_is_placed(place: Callable[[int], int], found: list[tuple[int, int]]) -> None:
    shifts = find_shifts(cast("Dataset", Wall(place)), "a")
    assert [(last, first) for last, first, _ in shifts] == found
    assert [px for *_, px in shifts] == pytest.approx([abs(place(b) - place(a)) for a, b in found], abs=0.2)


def test_a_camera_that_pans_has_no_rest_between_its_shifts() -> None:
    shifts = find_shifts(cast("Dataset", Wall(lambda k: 50 + 5 * k)), "a")
    rests = [later[0] - earlier[1] for earlier, later in pairwise(shifts)]
    assert len(shifts) == 6
    assert np.max(rests) <= 1
