"""The scene named `board`: the studio's room and cameras, before which the board that calibrates is moved."""

import cv2
import numpy as np

from capture_app.board.charuco import DEFAULT_BOARD
from capture_app.simulation.scenes import poses, studio
from capture_app.simulation.scenes.definition import SceneDefinition
from capture_app.simulation.scenes.meshes import panel, turn
from capture_app.simulation.scenes.moving_bodies import Part
from capture_app.simulation.scenes.poses import Poses, Series
from capture_app.simulation.scenes.textures import Picture

PAGE_M = (0.297, 0.210)
"""The sheet that `reconstruct board` fills."""
TEXELS_PER_MM = 4
CENTRE = (0.0, -0.05, 0.60)
REACH_M = (0.31, 0.27, 0.07)
"""How far the board is moved to either side, up and down, and to and from the cameras."""
TILT_RAD = (0.50, 0.62, 0.20)
"""How far it is turned about x, y and z."""
CYCLE_S = poses.CYCLE_NS / 1e9
TIMES_A_CYCLE = {"right": 9, "down": 5, "away": 4, "x": 11, "y": 13, "z": 7}
"""Whole numbers, none a multiple of another, so that places and tilts mix."""


def _sheet() -> Picture:
    square_px = round(1000 * DEFAULT_BOARD.square_m * TEXELS_PER_MM)
    board = DEFAULT_BOARD.picture(square_px)
    width, height = (round(1000 * side * TEXELS_PER_MM) for side in PAGE_M)
    sheet = np.full((height, width), 245, np.uint8)
    top, left = (height - board.shape[0]) // 2, (width - board.shape[1]) // 2
    sheet[top : top + board.shape[0], left : left + board.shape[1]] = np.where(board > 127, 245, 18)
    return np.asarray(cv2.cvtColor(sheet, cv2.COLOR_GRAY2BGR), np.uint8)


def _held(time_s: Series) -> dict[str, Poses]:
    """Poses of the sheet, slow enough to be sharp: at most 0.2 m/s."""
    wave = {name: np.sin(2 * np.pi * times * time_s / CYCLE_S) for name, times in TIMES_A_CYCLE.items()}
    place = np.stack([wave["right"], wave["down"], wave["away"]], axis=-1) * REACH_M + CENTRE
    tilts = (turn(axis, TILT_RAD[axis] * wave[name]) for axis, name in enumerate("xyz"))
    about_x, about_y, about_z = tilts
    return {"sheet": Poses(about_y @ about_x @ about_z, place)}


DEFINITION = SceneDefinition(
    cameras=studio.CAMERAS,
    pictures=lambda rng: studio.DEFINITION.pictures(rng) | {"sheet": _sheet()},
    fixtures=studio.fixtures,
    parts=lambda: {
        "sheet": Part(
            "board",
            [panel((-PAGE_M[0] / 2, -PAGE_M[1] / 2, 0), (PAGE_M[0], 0, 0), (0, PAGE_M[1], 0), "sheet")],
        )
    },
    poses=_held,
)
"""The studio without the child, whose cameras see the board from all sides."""
