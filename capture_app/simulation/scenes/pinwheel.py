"""The scene named `pinwheel`: little but the turning wheel, near, before a bare wall.

A picture shows hardly anything that stands still, so whoever takes the wheel of two different moments for
one gets the cameras' poses wrong.
"""

import numpy as np

from capture_app.simulation.scenes import moving_bodies, poses, textures
from capture_app.simulation.scenes.definition import Point, SceneDefinition
from capture_app.simulation.scenes.meshes import box, panel
from capture_app.simulation.scenes.moving_bodies import Part
from capture_app.simulation.scenes.textures import Picture

_X, _Y, _Z = poses.WHEEL_HUB
_WALL_Z = _Z + 0.95


def _looking(right: float, down: float, ahead: float) -> tuple[Point, Point]:
    """A camera at that place from the hub, in m, turned to the hub."""
    return (_X + right, _Y + down, _Z - ahead), (_X, _Y + 0.015, _Z)


def _pictures(rng: np.random.Generator) -> dict[str, Picture]:
    return moving_bodies.pictures(rng) | {
        "wall": textures.plain(rng, (500, 700), (150, 186, 190), rough=0.012),
        "board": textures.plain(rng, (64, 700), (236, 230, 214), rough=0.02),
        "pale_wood": textures.wood(rng, (128, 512), (206, 164, 112)),
        "dark_wood": textures.wood(rng, (128, 512), (96, 62, 42)),
    }


def _fixtures(rng: np.random.Generator) -> list[Part]:
    wall = panel((_X - 2.4, _Y - 2.0, _WALL_Z), (4.8, 0, 0), (0, 4.0, 0), "wall")
    return [
        Part("wall", [wall]),
        Part("rail", box((_X, _Y + 0.62, _WALL_Z - 0.01), (4.8, 0.06, 0.02), "board")),
        Part("stand", moving_bodies.stand()),
    ]


DEFINITION = SceneDefinition(
    cameras={
        "cam00": _looking(-0.07, 0.0, 0.80),
        "cam01": _looking(0.07, 0.0, 0.80),
        "cam02": _looking(0.24, -0.05, 0.78),
        "cam03": _looking(-0.24, 0.04, 0.78),
        "cam04": _looking(0.0, -0.20, 0.79),
    },
    pictures=_pictures,
    fixtures=_fixtures,
    parts=lambda: {name: part for name, part in moving_bodies.parts().items() if part.thing == "pinwheel"},
    poses=poses.turning_wheel,
)
"""A pinwheel that fills the pictures."""
