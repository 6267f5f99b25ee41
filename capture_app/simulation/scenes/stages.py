"""The scenes: the `studio`, two children who pass each other (`crossing`), a held `board`, the `pinwheel`.

An image of the pinwheel shows hardly anything static. Treating the wheel of two different moments as one
object therefore gives wrong camera poses.
"""

from functools import partial

import cv2
import numpy as np

from capture_app.board.boards import DEFAULT_BOARD
from capture_app.simulation.scenes.definition import Picture, Point, SceneDefinition, read_stage
from capture_app.simulation.scenes.moving_bodies import (
    CYCLE_NS,
    WHEEL_HUB,
    Poses,
    Series,
    jumping_child,
    rotation,
    turning_wheel,
    walking_child,
)

STUDIO_CAMERAS: dict[str, tuple[Point, Point]] = {
    "cam00": ((-0.08, 0.0, 0.0), (-0.015, 0.13, 2.9)),
    "cam01": ((0.08, 0.0, 0.0), (0.015, 0.13, 2.9)),
    # The wide pair: almost the same position, turned 13 degrees to either side.
    "cam02": ((-0.03, -0.10, 0.0), (-0.03 - 2.9 * 0.2309, 0.07, 2.9)),
    "cam03": ((0.03, -0.10, 0.0), (0.03 + 2.9 * 0.2309, 0.07, 2.9)),
    "cam04": ((0.26, -0.04, 0.02), (0.02, 0.13, 2.8)),
    "cam05": ((-0.26, -0.05, 0.02), (-0.02, 0.13, 2.8)),
    "cam06": ((0.0, -0.30, 0.02), (0.0, 0.14, 2.8)),
}
"""Position of each camera and the point that it looks at, in m."""
PAGE_M = (0.297, 0.210)
"""Size in m of the sheet that `reconstruct board` fills."""
TEXELS_PER_MM = 4
CENTRE = (0.0, -0.05, 0.60)
AMPLITUDE_M = (0.31, 0.27, 0.07)
"""Amplitude in m of the board's motion: sideways, vertically, and in depth."""
TILT_RAD = (0.50, 0.62, 0.20)
"""Amplitude in radians of its rotation about x, y and z."""
CYCLE_S = CYCLE_NS / 1e9
TIMES_A_CYCLE = {"right": 9, "down": 5, "away": 4, "x": 11, "y": 13, "z": 7}
"""Whole cycles per CYCLE_S, none a multiple of another, so that positions and tilts mix."""


def _turned(number: int) -> tuple[Point, Point]:
    """Return one of three cameras at almost the same position, turned 22 degrees from each other."""
    angle = np.deg2rad(22.0 * (number - 1))
    x = 0.015 * (number - 1)
    return (x, -0.10, 0.0), (x + 2.9 * float(np.tan(angle)), 0.06, 2.9)


def _sheet() -> Picture:
    square_px = round(1000 * DEFAULT_BOARD.square_m * TEXELS_PER_MM)
    board = DEFAULT_BOARD.picture(square_px)
    width, height = (round(1000 * side * TEXELS_PER_MM) for side in PAGE_M)
    sheet = np.full((height, width), 245, np.uint8)
    top, left = (height - board.shape[0]) // 2, (width - board.shape[1]) // 2
    sheet[top : top + board.shape[0], left : left + board.shape[1]] = np.where(board > 127, 245, 18)
    return np.asarray(cv2.cvtColor(sheet, cv2.COLOR_GRAY2BGR), np.uint8)


def _held(time_s: Series) -> dict[str, Poses]:
    """Return poses of the sheet, slow enough for sharp images: at most 0.2 m/s."""
    wave = {name: np.sin(2 * np.pi * times * time_s / CYCLE_S) for name, times in TIMES_A_CYCLE.items()}
    place = np.stack([wave["right"], wave["down"], wave["away"]], axis=-1) * AMPLITUDE_M + CENTRE
    tilts = (rotation(axis, TILT_RAD[axis] * wave[name]) for axis, name in enumerate("xyz"))
    about_x, about_y, about_z = tilts
    return {"sheet": Poses(about_y @ about_x @ about_z, place)}


def _looking(right: float, down: float, ahead: float) -> tuple[Point, Point]:
    """Return a camera that looks at the hub from that offset to it, in m."""
    x, y, z = WHEEL_HUB
    return (x + right, y + down, z - ahead), (x, y + 0.015, z)


DEFINITIONS = {
    "studio": SceneDefinition(
        STUDIO_CAMERAS,
        partial(read_stage, "studio"),
        lambda seconds: jumping_child(seconds) | turning_wheel(seconds),
    ),
    "pinwheel": SceneDefinition(
        {
            "cam00": _looking(-0.07, 0.0, 0.80),
            "cam01": _looking(0.07, 0.0, 0.80),
            "cam02": _looking(0.24, -0.05, 0.78),
            "cam03": _looking(-0.24, 0.04, 0.78),
            "cam04": _looking(0.0, -0.20, 0.79),
        },
        partial(read_stage, "pinwheel"),
        turning_wheel,
    ),
    "crossing": SceneDefinition(
        {f"cam0{number}": _turned(number) for number in range(3)},
        partial(read_stage, "crossing"),
        lambda seconds: (
            walking_child(seconds, ahead=0.0, prefix="first ")
            | walking_child(seconds, ahead=0.5, prefix="second ")
        ),
    ),
    "board": SceneDefinition(STUDIO_CAMERAS, lambda: read_stage("board", sheet=_sheet()), _held),
}
"""Scenes by name. In the studio a child jumps and a pinwheel turns; crossing and board share its room."""
