"""Points that determine no geometry are told from those that do."""

import numpy as np
import pytest

from reconstruction.common.geometry import Array
from reconstruction.scene.calibration.consistency import fit_one_plane

FOCAL_PX = 600.0
WALL = 4.0


def seen(points: Array, centre: tuple[float, float, float], turn_deg: float = 0.0) -> Array:
    """The pixels of points in a camera, with noise of 0.3 px."""
    turn = np.radians(turn_deg)
    turned = np.array([[np.cos(turn), 0, -np.sin(turn)], [0, 1, 0], [np.sin(turn), 0, np.cos(turn)]])
    there = (points - centre) @ turned.T
    noise = np.random.default_rng(len(points)).normal(0, 0.3, (len(points), 2))
    return FOCAL_PX * there[:, :2] / there[:, 2:] + 320 + noise


def places(depths: Array) -> Array:
    across = np.random.default_rng(1).uniform(-0.5, 0.5, (len(depths), 2))
    return np.column_stack([across * depths[:, None], depths])


ROOM = np.random.default_rng(2).uniform(2, 6, 400)
SCENES = {
    "a wall": (np.full(400, WALL), (0.2, 0.0, 0.0), 0.0, True),
    "a wall, seen askew": (np.full(400, WALL), (0.8, 0.1, 0.3), 12.0, True),
    "a crowd far away": (np.random.default_rng(3).uniform(80, 120, 400), (0.2, 0.0, 0.0), 2.0, True),
    "a camera that turned": (ROOM, (0.0, 0.0, 0.0), 15.0, True),
    "a wall and a few things": (np.append(np.full(390, WALL), np.full(10, 2.0)), (0.2, 0.0, 0.0), 0.0, True),
    "too few points": (ROOM[:6], (0.2, 0.0, 0.0), 0.0, True),
    "a room": (ROOM, (0.2, 0.0, 0.0), 3.0, False),
    "forward, in a room": (ROOM, (0.0, 0.0, 0.8), 0.0, False),
    "a wall and a table": (np.append(np.full(300, WALL), ROOM[:100]), (0.3, 0.0, 0.0), 0.0, False),
}


@pytest.mark.parametrize(("depths", "centre", "turn_deg", "flat"), SCENES.values(), ids=SCENES)
def test_one_plane(depths: Array, centre: tuple[float, float, float], turn_deg: float, flat: bool) -> None:
    points = places(depths)
    assert fit_one_plane(seen(points, (0.0, 0.0, 0.0)), seen(points, centre, turn_deg)) == flat
