"""The scene named `crossing`: two children walk past each other where wide pictures overlap."""

from dataclasses import replace

import numpy as np

from capture_app.simulation.scenes import moving_bodies, studio, textures
from capture_app.simulation.scenes.definition import Point, SceneDefinition
from capture_app.simulation.scenes.moving_bodies import Part
from capture_app.simulation.scenes.poses import walking_child
from capture_app.simulation.scenes.textures import Colour, Picture

_FIRST, _SECOND = "first ", "second "
_OWN_TEXTURES = ("shirt", "sleeve", "jeans", "shoe")
_IN_THE_WAY = ("ball", "pouf", "stand")


def _turned(number: int) -> tuple[Point, Point]:
    """One of three cameras nearly in one place, turned 22 degrees from each other."""
    angle = np.deg2rad(22.0 * (number - 1))
    x = 0.015 * (number - 1)
    return (x, -0.10, 0.0), (x + 2.9 * float(np.tan(angle)), 0.06, 2.9)


def _pictures(rng: np.random.Generator) -> dict[str, Picture]:
    found = moving_bodies.pictures(rng) | studio.pictures(rng)
    stripes: list[Colour] = [(236, 190, 78), (54, 112, 104), (244, 234, 212), (54, 112, 104)]
    found[_SECOND + "shirt"] = textures.cloth(rng, (220, 330), stripes, stripe=23)
    found[_SECOND + "sleeve"] = textures.cloth(rng, (64, 96), stripes, stripe=18)
    found[_SECOND + "jeans"] = textures.cloth(rng, (160, 200), [(164, 92, 66), (150, 82, 58)], stripe=6)
    found[_SECOND + "shoe"] = textures.cloth(rng, (96, 160), [(232, 226, 212)])
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


DEFINITION = SceneDefinition(
    cameras={f"cam0{number}": _turned(number) for number in range(3)},
    pictures=_pictures,
    fixtures=lambda rng: [part for part in studio.fixtures(rng) if part.thing not in _IN_THE_WAY],
    parts=_parts,
    poses=lambda seconds: (
        walking_child(seconds, ahead=0.0, prefix=_FIRST) | walking_child(seconds, ahead=0.5, prefix=_SECOND)
    ),
)
"""The studio's room, with two children who walk round in it and three cameras side by side."""
