"""Rooms with nearly blank walls, slanted floors, thin rods, leaves and a child, by the project's renderer."""

from collections.abc import Callable
from functools import partial

import numpy as np

from benchmarks.scenery import materials
from benchmarks.scenery.meshes import Mesh, box, ellipsoid, panel, rod
from capture_app.plugins.cameras.sim.scenes.moving_bodies import jumping_child, rotation, walking_child
from capture_app.plugins.cameras.sim.scenes.stages import (
    Part,
    Picture,
    Point,
    SceneDefinition,
    SceneStage,
    read_stage,
)

SEED = 20190516
FLOOR, BACK, FRONT, TOP = 1.0, 4.3, 0.6, -2.2
LEFT, RIGHT = -2.3, 2.3
"""Walls, floor and ceiling of the studio, in m; the objects in these rooms come from there."""
NEARLY_BLANK = 0.004
"""Standard deviation of a wall's paint, of 1: below the noise of an image."""
WEAK = 0.018
"""Standard deviation of a floor's paint: about the noise."""

ROOM_CAMERAS: dict[str, tuple[Point, Point]] = {
    "cam0": ((-0.30, -0.02, 0.0), (-0.02, 0.10, 2.9)),
    "cam1": ((-0.15, 0.05, 0.0), (-0.01, 0.10, 2.9)),
    "cam2": ((0.0, -0.03, 0.0), (0.0, 0.10, 2.9)),
    "cam3": ((0.15, 0.03, 0.02), (0.01, 0.10, 2.9)),
    "cam4": ((0.30, -0.06, 0.02), (0.02, 0.10, 2.9)),
}
ATTIC_CAMERAS: dict[str, tuple[Point, Point]] = {
    "cam0": ((-0.50, -0.10, 0.1), (-0.10, 0.15, 2.8)),
    "cam1": ((-0.26, -0.30, 0.0), (-0.05, 0.15, 2.8)),
    "cam2": ((0.02, -0.12, 0.0), (0.0, 0.15, 2.8)),
    "cam3": ((0.24, -0.28, 0.0), (0.05, 0.15, 2.8)),
    "cam4": ((0.46, -0.08, 0.1), (0.10, 0.15, 2.8)),
}


def _pictures(rng: np.random.Generator) -> dict[str, Picture]:
    return {
        "wall": materials.plain(rng, (700, 900), (226, 220, 208), rough=NEARLY_BLANK),
        "side": materials.plain(rng, (700, 900), (204, 210, 206), rough=NEARLY_BLANK),
        "door": materials.plain(rng, (400, 200), (186, 190, 182), rough=NEARLY_BLANK),
        "cupboard": materials.plain(rng, (300, 300), (150, 172, 176), rough=NEARLY_BLANK),
        "lino": materials.plain(rng, (1200, 1400), (168, 150, 132), rough=WEAK),
        "rail": materials.plain(rng, (64, 700), (120, 112, 104), rough=0.05),
        "steel": materials.plain(rng, (64, 200), (72, 76, 82), rough=0.06),
        "lamp": materials.plain(rng, (120, 240), (236, 228, 206), rough=NEARLY_BLANK),
        "boards": materials.planks(rng, (200, 260), (196, 152, 100), width=40, length=200),
    }


def _ramp(front_m: float, back_m: float, tilt_m: float, texture: str) -> Mesh:
    """Return a floor with these heights at front and back edge (y in m), raised on its right by the tilt."""
    across, along = RIGHT - LEFT + 0.4, BACK - FRONT + 0.2
    return panel(
        (LEFT - 0.2, front_m, FRONT), (across, -tilt_m, 0), (0, back_m - front_m, along), texture
    )  # fmt: skip


def _rods(rng: np.random.Generator, *, z: float, slant: float, count: int) -> list[Mesh]:
    """Return bars from 6 to 14 mm thick between a rail above and one below."""
    meshes = []
    for number in range(count):
        x = -1.0 + 2.0 * number / (count - 1) + rng.uniform(-0.03, 0.03)
        top = (x + slant, -0.55, z + 0.1 * np.sin(number))
        meshes.append(rod((x, 0.8, z), top, rng.uniform(0.003, 0.007), "steel", around=8))
    return [*meshes, rod((-1.1 + slant, -0.55, z), (1.1 + slant, -0.55, z), 0.012, "dark_wood")]


def _room(rng: np.random.Generator, plant: list[Mesh]) -> list[Part]:
    high, deep = FLOOR + 0.3 - TOP, BACK - FRONT
    walls = [
        panel((LEFT, TOP, BACK), (RIGHT - LEFT, 0, 0), (0, high, 0), "wall"),
        panel((LEFT, TOP, FRONT), (0, 0, deep), (0, high, 0), "side"),
        panel((RIGHT, TOP, FRONT), (0, 0, deep), (0, high, 0), "side"),
    ]
    walls += box((0.9, 0.05, BACK - 0.01), (0.9, 2.0, 0.05), "door")
    cupboard = [
        m.moved((-1.5, 0.55, 3.5), rotation(1, 0.5)) for m in box((0, 0, 0), (0.7, 1.0, 0.5), "cupboard")
    ]
    pictures = [
        panel((-1.0, -0.95, BACK - 0.012), (0.5, 0, 0), (0, 0.68, 0), "shapes"),
        panel((-0.25, -0.65, BACK - 0.012), (0.56, 0, 0), (0, 0.4, 0), "city"),
        panel((LEFT + 0.01, -0.7, 3.0), (0, 0, 0.55), (0, 0.75, 0), "words"),
    ]
    lamp = [ellipsoid((0.16, 0.16, 0.16), "lamp").moved((1.75, 0.45, 3.4))]
    return [
        Part("floor", [_ramp(1.1, 0.72, 0.12, "lino")]),
        Part("walls", walls),
        Part("cupboard", cupboard),
        Part("pictures", pictures),
        Part("lamp", lamp),
        Part("rods", [m.moved((0.65, 0.0, 0.0)) for m in _rods(rng, z=3.0, slant=0.15, count=7)]),
        Part("plant", [m.moved((0.75, -0.12, 0.2)) for m in plant]),
    ]


def _attic(rng: np.random.Generator, plant: list[Mesh]) -> list[Part]:
    across, deep = RIGHT - LEFT, BACK - FRONT
    walls = [
        # The gable, and two sides of the roof that lean inwards.
        panel((LEFT, TOP, BACK), (across, 0.0, -0.5), (0, 3.6, 0), "wall"),
        panel((-0.9, TOP, FRONT), (0.3, 0, deep), (-1.5, 3.4, 0), "side"),
        panel((1.4, TOP, FRONT), (0, 0, deep), (1.1, 3.4, 0), "side"),
        *box((0.75, 0.2, 3.75), (0.42, 3.2, 0.35), "cupboard"),
    ]
    pictures = [
        panel((-0.75, -0.72, BACK - 0.2), (0.6, 0, -0.065), (0, 0.44, 0), "harbour"),
        panel((0.55, -0.45, 3.57), (0.4, 0, 0), (0, 0.55, 0), "mountains"),
        *box((-0.9, 0.8, 3.1), (0.6, 0.35, 0.45), "boards"),
    ]
    return [
        Part("floor", [_ramp(1.25, 0.6, -0.3, "lino"), _ramp(1.2, 1.0, 0.5, "rail")]),
        Part("walls", walls),
        Part("pictures", pictures),
        Part("rods", [m.moved((-0.35, 0.1, 0.2)) for m in _rods(rng, z=2.7, slant=-0.3, count=9)]),
        Part("plant", [m.moved((2.75, -0.25, -0.35)) for m in plant]),
    ]


def _stage(fixtures: Callable[[np.random.Generator, list[Mesh]], list[Part]]) -> SceneStage:
    """Build one of the rooms, with the studio's child, plant and pictures."""
    rng, studio = np.random.default_rng(SEED), read_stage("studio")
    pictures = studio.pictures | _pictures(rng)
    child = {name: part for name, part in studio.parts.items() if part.thing == "figure"}
    plant = next(part.meshes for part in studio.fixtures if part.thing == "plant")
    return SceneStage(fixtures(rng, [Mesh(**vars(mesh)) for mesh in plant]), child, pictures)


ROOM = SceneDefinition(ROOM_CAMERAS, partial(_stage, _room), jumping_child)
"""Upright walls, a ramp for a floor, a door, three pictures."""
ATTIC = SceneDefinition(
    ATTIC_CAMERAS, partial(_stage, _attic), lambda seconds: walking_child(seconds, ahead=0.3, prefix="")
)
"""Leaning walls, two crossing ramps, a chimney, and cameras that are farther apart."""
