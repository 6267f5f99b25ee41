"""The scenes: the `studio`, two children who pass each other (`crossing`), a held `board`, the `pinwheel`.

A scene has static parts, moving parts and cameras. An image of the pinwheel shows hardly anything static.
Treating the wheel of two different moments as one object therefore gives wrong camera poses.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from capture_app.board.boards import DEFAULT_BOARD
from capture_app.common.grouping import grouped
from capture_app.plugins.cameras.sim.scenes.moving_bodies import (
    CYCLE_NS,
    WHEEL_HUB,
    Poses,
    Series,
    jumping_child,
    rotation,
    turning_wheel,
    walking_child,
)

Floats = NDArray[np.float32]
Picture = NDArray[np.uint8]
"""A texture: sRGB, BGR."""
Point = tuple[float, float, float]
FILES = Path(__file__).parent / "files"
"""NAME.npz: meshes of the scene NAME, in the order of its table `meshes`; TEXTURE.webp: lossless textures."""
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


@dataclass(frozen=True)
class Mesh:
    """Triangles (T, 3) over vertices (V, 3) in m; each vertex has a normal and a texture coordinate.

    Axes as OpenCV's camera: x right, y down, z away from the viewer.
    """

    vertices: Floats
    normals: Floats
    uv: Floats
    triangles: NDArray[np.integer]
    texture: str


@dataclass(frozen=True)
class Part:
    """Meshes of one rigid part, relative to its joint if it moves, and the object it belongs to."""

    thing: str
    meshes: Sequence[Mesh]


@dataclass(frozen=True)
class SceneStage:
    """All visible parts of a scene: static parts, and moving parts by name."""

    fixtures: list[Part]
    parts: dict[str, Part]
    pictures: dict[str, Picture]
    """Textures by name."""


@dataclass(frozen=True)
class SceneDefinition:
    """Cameras, parts and motion of one scene."""

    cameras: Mapping[str, tuple[Point, Point]]
    """Position of each camera and the point that it looks at, in m."""
    stage: Callable[[], SceneStage]
    poses: Callable[[Series], dict[str, Poses]]
    """Poses of the moving parts at the times, in s, by the part's name."""


def read_stage(name: str, **drawn: Picture) -> SceneStage:
    """Read a scene's meshes and textures from `FILES`; textures passed in `drawn` are not read."""
    kinds = ("vertices", "normals", "uv", "triangles")
    with np.load(FILES / f"{name}.npz") as data:
        table = data["meshes"]
        ends = {kind: table["triangles" if kind == "triangles" else "vertices"].cumsum() for kind in kinds}
        shapes = [np.split(data[kind], ends[kind]) for kind in kinds]
    meshes = grouped(
        (
            (str(row["part"]), str(row["thing"])),
            Mesh(texture=str(row["texture"]), **dict(zip(kinds, shape, strict=True))),
        )
        for row, *shape in zip(table, *shapes, strict=False)
    )
    parts = {name: Part(thing, own) for (name, thing), own in meshes.items() if name}
    fixtures = [Part(thing, own) for (name, thing), own in meshes.items() if not name]
    textures = set(table["texture"].tolist()) - set(drawn)
    pictures = {
        texture: np.asarray(cv2.imread(str(FILES / f"{texture}.webp")), np.uint8) for texture in textures
    }
    return SceneStage(fixtures, parts, pictures | drawn)


def _turned(number: int) -> tuple[Point, Point]:
    """Return one of three cameras at almost the same position, turned 22 degrees from each other."""
    angle = np.deg2rad(22.0 * (number - 1))
    x = 0.015 * (number - 1)
    return (x, -0.10, 0.0), (x + 2.9 * float(np.tan(angle)), 0.06, 2.9)


def _sheet() -> Picture:
    board = DEFAULT_BOARD.picture(round(1000 * DEFAULT_BOARD.square_m * TEXELS_PER_MM))
    width, height = (round(1000 * side * TEXELS_PER_MM) for side in PAGE_M)
    sheet = np.full((height, width), 245, np.uint8)
    top, left = (height - board.shape[0]) // 2, (width - board.shape[1]) // 2
    sheet[top : top + board.shape[0], left : left + board.shape[1]] = np.where(board > 127, 245, 18)
    return np.asarray(cv2.cvtColor(sheet, cv2.COLOR_GRAY2BGR), np.uint8)


def _held(time_s: Series) -> dict[str, Poses]:
    """Return poses of the sheet, slow enough for sharp images: at most 0.2 m/s."""
    wave = {name: np.sin(2 * np.pi * times * time_s / CYCLE_S) for name, times in TIMES_A_CYCLE.items()}
    place = np.stack([wave["right"], wave["down"], wave["away"]], axis=-1) * AMPLITUDE_M + CENTRE
    about_x, about_y, about_z = (rotation(axis, TILT_RAD[axis] * wave[at]) for axis, at in enumerate("xyz"))
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
