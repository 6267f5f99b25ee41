"""The picture of a cloud from six places, as cameras around a thing or on one side of it see it."""

import numpy as np
import pytest

from reconstruction.common.geometry import Array, View
from reconstruction.methods.multiview.mesh import draw_clouds

RADIUS, AWAY = 0.3, 1.3
GROUND = 32
"""Grey level of what shows nothing."""


def camera(round_deg: float) -> View:
    """A camera that looks at the origin, y down, from `AWAY` m, so many degrees round it."""
    turn = np.radians(round_deg)
    rotation = np.array([[np.cos(turn), 0, -np.sin(turn)], [0, 1, 0], [np.sin(turn), 0, np.cos(turn)]])
    matrix = np.array([[400.0, 0, 159.5], [0, 400, 119.5], [0, 0, 1]])
    return View(320, 240, matrix, np.zeros(5), rotation, np.array([0.0, 0, AWAY]))


@pytest.fixture(scope="module")
def ball() -> tuple[Array, Array]:
    """The points and colours of a ball, red towards +x, green towards +z, blue below."""
    height, turn = np.meshgrid(np.linspace(-1, 1, 150), np.linspace(0, 2 * np.pi, 300))
    wide = np.sqrt(1 - height**2)
    points = np.stack([wide * np.cos(turn), height, wide * np.sin(turn)], axis=-1).reshape(-1, 3)
    return RADIUS * points, (255 * (0.5 + 0.45 * points[:, [0, 2, 1]])).astype(np.uint8)


def frames(cloud: tuple[Array, Array], *round_deg: float) -> list[Array]:
    picture = draw_clouds({"ball": cloud}, [camera(turn) for turn in round_deg])["ball"]
    rows = np.split(picture, 2, axis=0)
    return [frame for row in rows for frame in np.split(row, 3, axis=1)]


def shown(frame: Array) -> Array:
    return np.asarray((frame != GROUND).any(2))


def directions_deg(seen: list[Array]) -> Array:
    """From where each frame shows the ball, degrees round it, by the mean of its colours."""
    means = np.array([frame[shown(frame)].mean(0) / 255 - 0.5 for frame in seen])
    return np.asarray(np.degrees(np.arctan2(-means[:, 2], -means[:, 1])) % 360)


def test_a_ring_is_left_to_see_the_thing_whole_from_all_round(ball: tuple[Array, Array]) -> None:
    seen = frames(ball, *range(0, 360, 30))
    width, height = 480, 360
    # 65 degrees wide; outside the ring the ball is smaller than any of its cameras would see it.
    focal = width / 2 / np.tan(np.radians(65 / 2))
    from_a_camera = focal * np.tan(np.arcsin(RADIUS / AWAY))
    for frame in seen:
        rows, columns = np.nonzero(shown(frame))
        assert abs(rows.mean() - height / 2) < 3
        assert abs(columns.mean() - width / 2) < 3
        assert 0.8 * from_a_camera < np.ptp(columns) / 2 < 0.95 * from_a_camera
        # What is below in the cameras' pictures is below here.
        assert frame[rows.max() - 10, width // 2, 0] > frame[rows.min() + 10, width // 2, 0]
    turns = np.sort(directions_deg(seen))
    assert np.diff(turns) == pytest.approx(np.full(5, 60.0), abs=8)


def test_a_row_of_cameras_is_shown_its_own_side(ball: tuple[Array, Array]) -> None:
    turns = (directions_deg(frames(ball, -12, 0, 12)) + 180) % 360 - 180
    assert np.sort(turns) == pytest.approx([-50, -30, -10, 10, 30, 50], abs=8)
