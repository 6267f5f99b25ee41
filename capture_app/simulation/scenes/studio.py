"""The room named `studio`: what stands still in it, and where the cameras are."""

import numpy as np

from capture_app.simulation.scenes import furniture, moving_bodies, poses, posters, prints, textures
from capture_app.simulation.scenes.definition import SceneDefinition
from capture_app.simulation.scenes.furniture import BACK, FLOOR, FRONT, LEFT, RIGHT, TOP
from capture_app.simulation.scenes.meshes import Mesh, box, panel
from capture_app.simulation.scenes.moving_bodies import Part
from capture_app.simulation.scenes.textures import Picture

CAMERAS: dict[str, tuple[tuple[float, float, float], tuple[float, float, float]]] = {
    "cam00": ((-0.08, 0.0, 0.0), (-0.015, 0.13, 2.9)),
    "cam01": ((0.08, 0.0, 0.0), (0.015, 0.13, 2.9)),
    # The wide pair: nearly one place, turned 13 degrees to either side.
    "cam02": ((-0.03, -0.10, 0.0), (-0.03 - 2.9 * 0.2309, 0.07, 2.9)),
    "cam03": ((0.03, -0.10, 0.0), (0.03 + 2.9 * 0.2309, 0.07, 2.9)),
    "cam04": ((0.26, -0.04, 0.02), (0.02, 0.13, 2.8)),
    "cam05": ((-0.26, -0.05, 0.02), (-0.02, 0.13, 2.8)),
    "cam06": ((0.0, -0.30, 0.02), (0.0, 0.14, 2.8)),
}
"""Where each camera is and the point that it looks at, in m."""


def pictures(rng: np.random.Generator) -> dict[str, Picture]:
    """Textures of the room, by name."""
    boards = textures.planks(rng, (200, 260), (196, 152, 100), width=40, length=200)
    found = {
        "floor": textures.planks(rng, (1500, 1900), (178, 126, 80), width=48, length=520),
        "brick": textures.bricks(rng, (800, 1150), brick=(19, 54)),
        "paper": textures.wallpaper(rng, (900, 1000), (84, 112, 100)),
        "plaster": textures.plain(rng, (600, 700), (222, 208, 184), rough=0.07),
        "skirting": textures.wood(rng, (48, 1200), (232, 224, 208), contrast=0.5),
        "pale_wood": textures.wood(rng, (128, 512), (206, 164, 112)),
        "dark_wood": textures.wood(rng, (128, 512), (96, 62, 42)),
        "shelf_wood": textures.wood(rng, (128, 700), (150, 104, 66)),
        "rug": textures.kilim(rng, (420, 760)),
        "boards": boards,
        "stencil": prints.stencil(rng, boards),
        "leaf": textures.leaf(rng, (160, 64), (62, 112, 58)),
        "leaf_light": textures.leaf(rng, (160, 64), (98, 142, 70)),
        "soil": textures.plain(rng, (64, 64), (66, 48, 36), rough=0.3),
        "pot": textures.plain(rng, (120, 240), (190, 104, 70), rough=0.08),
        "basket": textures.cloth(rng, (120, 260), [(196, 156, 104), (150, 108, 66)], stripe=9, fade=1.6),
        "pouf": textures.cloth(rng, (160, 420), [(206, 150, 66), (226, 208, 176), (62, 108, 112)], stripe=15),
        "ball": prints.ball(rng),
        "mountains": posters.mountains(rng),
        "shapes": posters.shapes(rng),
        "harbour": posters.harbour(rng),
        "words": posters.words(rng),
        "city": posters.city(rng),
    }
    for number in range(24):
        found[f"book{number}"] = prints.spine(rng)
    for number, colour in enumerate(prints.WARM):
        found[f"flag{number}"] = textures.cloth(rng, (72, 72), [colour])
    return found


def fixtures(rng: np.random.Generator) -> list[Part]:
    """Everything that stands still, floor and walls first."""
    return [
        Part("floor", [panel((LEFT, FLOOR, FRONT), (0, 0, BACK - FRONT), (RIGHT - LEFT, 0, 0), "floor")]),
        Part("walls", _walls()),
        # Its top alone: of two faces in one plane, the processor's rounding would pick the one in sight.
        Part("rug", [panel((-1.075, FLOOR - 0.01, 2.02), (2.15, 0, 0), (0, 0, 1.2), "rug")]),
        Part("pictures", furniture.framed_pictures()),
        Part("bunting", furniture.bunting()),
        Part("shelf", furniture.shelf(rng)),
        Part("plant", furniture.plant(rng)),
        Part("crate", furniture.crate()),
        Part("pouf", furniture.pouf()),
        Part("ball", furniture.ball()),
        Part("stand", moving_bodies.stand()),
    ]


def _walls() -> list[Mesh]:
    high = FLOOR - TOP
    deep = BACK - FRONT
    walls = [
        panel((LEFT, TOP, BACK), (RIGHT - LEFT, 0, 0), (0, high, 0), "brick"),
        panel((LEFT, TOP, FRONT), (0, 0, deep), (0, high, 0), "paper", window=(0, 0, 1.15, 1)),
        panel((RIGHT, TOP, FRONT), (0, 0, deep), (0, high, 0), "paper", window=(0.4, 0, 1.55, 1)),
    ]
    walls += box((0.0, FLOOR - 0.06, BACK - 0.009), (RIGHT - LEFT, 0.12, 0.018), "skirting")
    for x in (LEFT + 0.009, RIGHT - 0.009):
        walls += box((x, FLOOR - 0.06, (FRONT + BACK) / 2), (0.018, 0.12, deep), "skirting")
    return walls


DEFINITION = SceneDefinition(
    cameras=CAMERAS,
    pictures=lambda rng: moving_bodies.pictures(rng) | pictures(rng),
    fixtures=fixtures,
    parts=moving_bodies.parts,
    poses=lambda seconds: poses.jumping_child(seconds) | poses.turning_wheel(seconds),
)
"""A room in which a child jumps and a pinwheel turns."""
