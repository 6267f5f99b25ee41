"""The scenes beside the studio: `crossing`, two children who pass each other, the `board`, the `pinwheel`.

Of the pinwheel a picture shows hardly anything that stands still, so whoever takes the wheel of two
different moments for one gets the cameras' poses wrong.
"""

from dataclasses import replace

import cv2
import numpy as np

from capture_app.board.boards import DEFAULT_BOARD
from capture_app.simulation.scenes import materials, moving_bodies, studio
from capture_app.simulation.scenes.definition import Point, SceneDefinition
from capture_app.simulation.scenes.materials import Colour, Picture
from capture_app.simulation.scenes.meshes import box, panel, turn
from capture_app.simulation.scenes.moving_bodies import Part, Poses, Series, walking_child

_FIRST, _SECOND = "first ", "second "
_OWN_TEXTURES = ("shirt", "sleeve", "jeans", "shoe")
_IN_THE_WAY = ("ball", "pouf", "stand")


def _turned(number: int) -> tuple[Point, Point]:
    """One of three cameras nearly in one place, turned 22 degrees from each other."""
    angle = np.deg2rad(22.0 * (number - 1))
    x = 0.015 * (number - 1)
    return (x, -0.10, 0.0), (x + 2.9 * float(np.tan(angle)), 0.06, 2.9)


def _crossing_pictures(rng: np.random.Generator) -> dict[str, Picture]:
    found = moving_bodies.pictures(rng) | studio.pictures(rng)
    stripes: list[Colour] = [(236, 190, 78), (54, 112, 104), (244, 234, 212), (54, 112, 104)]
    found[_SECOND + "shirt"] = materials.cloth(rng, (220, 330), stripes, stripe=23)
    found[_SECOND + "sleeve"] = materials.cloth(rng, (64, 96), stripes, stripe=18)
    found[_SECOND + "jeans"] = materials.cloth(rng, (160, 200), [(164, 92, 66), (150, 82, 58)], stripe=6)
    found[_SECOND + "shoe"] = materials.cloth(rng, (96, 160), [(232, 226, 212)])
    return found


def _parts() -> dict[str, Part]:
    child = {name: part for name, part in moving_bodies.parts().items() if part.thing == "figure"}
    found = {_FIRST + name: Part("first walker", part.meshes) for name, part in child.items()}
    for name, part in child.items():
        meshes = [
            replace(mesh, texture=_SECOND + mesh.texture) if mesh.texture in _OWN_TEXTURES else mesh
            for mesh in part.meshes
        ]
        found[_SECOND + name] = Part("second walker", meshes)
    return found


CROSSING = SceneDefinition(
    cameras={f"cam0{number}": _turned(number) for number in range(3)},
    pictures=_crossing_pictures,
    fixtures=lambda rng: [part for part in studio.fixtures(rng) if part.thing not in _IN_THE_WAY],
    parts=_parts,
    poses=lambda seconds: (
        walking_child(seconds, ahead=0.0, prefix=_FIRST) | walking_child(seconds, ahead=0.5, prefix=_SECOND)
    ),
)
"""The studio's room, with two children who walk round in it and three cameras side by side."""


PAGE_M = (0.297, 0.210)
"""The sheet that `reconstruct board` fills."""
TEXELS_PER_MM = 4
CENTRE = (0.0, -0.05, 0.60)
REACH_M = (0.31, 0.27, 0.07)
"""How far the board is moved to either side, up and down, and to and from the cameras."""
TILT_RAD = (0.50, 0.62, 0.20)
"""How far it is turned about x, y and z."""
CYCLE_S = moving_bodies.CYCLE_NS / 1e9
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


HELD_BOARD = SceneDefinition(
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


_X, _Y, _Z = moving_bodies.WHEEL_HUB
_WALL_Z = _Z + 0.95


def _looking(right: float, down: float, ahead: float) -> tuple[Point, Point]:
    """A camera at that place from the hub, in m, turned to the hub."""
    return (_X + right, _Y + down, _Z - ahead), (_X, _Y + 0.015, _Z)


def _pinwheel_pictures(rng: np.random.Generator) -> dict[str, Picture]:
    return moving_bodies.pictures(rng) | {
        "wall": materials.plain(rng, (500, 700), (150, 186, 190), rough=0.012),
        "board": materials.plain(rng, (64, 700), (236, 230, 214), rough=0.02),
        "pale_wood": materials.wood(rng, (128, 512), (206, 164, 112)),
        "dark_wood": materials.wood(rng, (128, 512), (96, 62, 42)),
    }


def _fixtures(rng: np.random.Generator) -> list[Part]:
    wall = panel((_X - 2.4, _Y - 2.0, _WALL_Z), (4.8, 0, 0), (0, 4.0, 0), "wall")
    return [
        Part("wall", [wall]),
        Part("rail", box((_X, _Y + 0.62, _WALL_Z - 0.01), (4.8, 0.06, 0.02), "board")),
        Part("stand", moving_bodies.stand()),
    ]


PINWHEEL = SceneDefinition(
    cameras={
        "cam00": _looking(-0.07, 0.0, 0.80),
        "cam01": _looking(0.07, 0.0, 0.80),
        "cam02": _looking(0.24, -0.05, 0.78),
        "cam03": _looking(-0.24, 0.04, 0.78),
        "cam04": _looking(0.0, -0.20, 0.79),
    },
    pictures=_pinwheel_pictures,
    fixtures=_fixtures,
    parts=lambda: {name: part for name, part in moving_bodies.parts().items() if part.thing == "pinwheel"},
    poses=moving_bodies.turning_wheel,
)
"""A pinwheel that fills the pictures."""
