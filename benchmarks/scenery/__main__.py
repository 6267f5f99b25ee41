"""Makes the files of the simulated scenes, `capture_app/simulation/scenes/files`: meshes and textures.

`python -m benchmarks.scenery [FOLDER]`. Another OpenCV or numpy may paint otherwise: then all samples change.
"""

import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from benchmarks.scenery import bodies, materials, studio
from benchmarks.scenery.materials import Colour
from benchmarks.scenery.meshes import box, panel
from capture_app.simulation.scenes.definition import FILES, Part, Picture, Stage
from capture_app.simulation.scenes.moving_bodies import WHEEL_HUB
from capture_app.simulation.scenes.stages import PAGE_M

SEED = 20190516
SECOND = "second "
OWN_TEXTURES = ("shirt", "sleeve", "jeans", "shoe")
"""What the second child does not share with the first."""
IN_THE_WAY = ("ball", "pouf", "stand")
"""What stands where the children walk."""


def figure() -> dict[str, Part]:
    """The parts of a child by name."""
    return {name: part for name, part in bodies.parts().items() if part.thing == "figure"}


def studio_stage() -> Stage:
    """The room, the child and the pinwheel."""
    rng = np.random.default_rng(SEED)
    pictures = bodies.pictures(rng) | studio.pictures(rng)
    return Stage(studio.fixtures(rng), bodies.parts(), pictures)


def board_stage() -> Stage:
    """The studio, and a sheet in the place of what moves; its texture is the board itself."""
    wide, high = PAGE_M
    sheet = panel((-wide / 2, -high / 2, 0), (wide, 0, 0), (0, high, 0), "sheet")
    return replace(studio_stage(), parts={"sheet": Part("board", [sheet])})


def crossing_stage() -> Stage:
    """The studio, cleared for two children, the second in other clothes."""
    rng = np.random.default_rng(SEED)
    found = bodies.pictures(rng) | studio.pictures(rng)
    stripes: list[Colour] = [(236, 190, 78), (54, 112, 104), (244, 234, 212), (54, 112, 104)]
    found[SECOND + "shirt"] = materials.cloth(rng, (220, 330), stripes, stripe=23)
    found[SECOND + "sleeve"] = materials.cloth(rng, (64, 96), stripes, stripe=18)
    found[SECOND + "jeans"] = materials.cloth(rng, (160, 200), [(164, 92, 66), (150, 82, 58)], stripe=6)
    found[SECOND + "shoe"] = materials.cloth(rng, (96, 160), [(232, 226, 212)])
    parts = {f"first {name}": Part("first walker", part.meshes) for name, part in figure().items()}
    for name, part in figure().items():
        meshes = [
            replace(mesh, texture=SECOND + mesh.texture) if mesh.texture in OWN_TEXTURES else mesh
            for mesh in part.meshes
        ]
        parts[SECOND + name] = Part("second walker", meshes)
    fixtures = [part for part in studio.fixtures(rng) if part.thing not in IN_THE_WAY]
    return Stage(fixtures, parts, found)


def pinwheel_stage() -> Stage:
    """A wall with a rail, and the pinwheel before it."""
    rng = np.random.default_rng(SEED)
    pictures = bodies.pictures(rng) | {
        "pinwheel wall": materials.plain(rng, (500, 700), (150, 186, 190), rough=0.012),
        "pinwheel board": materials.plain(rng, (64, 700), (236, 230, 214), rough=0.02),
        "pinwheel pale_wood": materials.wood(rng, (128, 512), (206, 164, 112)),
        "pinwheel dark_wood": materials.wood(rng, (128, 512), (96, 62, 42)),
    }
    x, y, z = WHEEL_HUB[0], WHEEL_HUB[1], WHEEL_HUB[2] + 0.95
    wall = panel((x - 2.4, y - 2.0, z), (4.8, 0, 0), (0, 4.0, 0), "pinwheel wall")
    fixtures = [
        Part("wall", [wall]),
        Part("rail", box((x, y + 0.62, z - 0.01), (4.8, 0.06, 0.02), "pinwheel board")),
        Part("stand", [replace(mesh, texture=f"pinwheel {mesh.texture}") for mesh in bodies.stand()]),
    ]
    parts = {name: part for name, part in bodies.parts().items() if part.thing == "pinwheel"}
    return Stage(fixtures, parts, pictures)


def write_stage(folder: Path, name: str, stage: Stage) -> None:
    """Write a scene's meshes, and the textures that they use, but for those that the scene draws itself."""
    named = [("", part) for part in stage.fixtures] + list(stage.parts.items())
    each = [(name, part.thing, mesh) for name, part in named for mesh in part.meshes]
    rows = [(part, thing, m.texture, len(m.vertices), len(m.triangles)) for part, thing, m in each]
    kinds = [("part", "U24"), ("thing", "U24"), ("texture", "U24"), ("vertices", int), ("triangles", int)]
    joined = {
        kind: np.concatenate([getattr(mesh, kind) for _, _, mesh in each])
        for kind in ("vertices", "normals", "uv")
    }
    triangles = np.concatenate([mesh.triangles for _, _, mesh in each]).astype(np.uint16)
    np.savez_compressed(
        folder / f"{name}.npz",
        meshes=np.array(rows, kinds),
        triangles=triangles,
        allow_pickle=False,
        **joined,
    )
    for texture in {mesh.texture for _, _, mesh in each} & stage.pictures.keys():
        _write_picture(folder / f"{texture}.webp", stage.pictures[texture])


def _write_picture(path: Path, picture: Picture) -> None:
    # Above 100 it is without loss.
    data = cv2.imencode(".webp", picture, [cv2.IMWRITE_WEBP_QUALITY, 101])[1].tobytes()
    if path.exists() and path.read_bytes() != data:
        print(f"{path.name} is another picture than before")
    path.write_bytes(data)


def main() -> None:
    """Write all files."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else FILES
    folder.mkdir(exist_ok=True)
    for name, stage in (
        ("studio", studio_stage),
        ("board", board_stage),
        ("crossing", crossing_stage),
        ("pinwheel", pinwheel_stage),
    ):
        write_stage(folder, name, stage())


if __name__ == "__main__":
    main()
