"""Definition of a scene: static parts, moving parts, and cameras."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from capture_app.simulation.scenes.moving_bodies import Poses, Series

Floats = NDArray[np.float32]
Picture = NDArray[np.uint8]
"""A texture: sRGB, BGR."""
Point = tuple[float, float, float]

FILES = Path(__file__).parent / "files"
"""NAME.npz: meshes of the scene NAME, in the order of its table `meshes`; TEXTURE.webp: lossless textures."""


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
class Stage:
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
    stage: Callable[[], Stage]
    poses: Callable[[Series], dict[str, Poses]]
    """Poses of the moving parts at the times, in s, by the part's name."""


def read_stage(name: str, **drawn: Picture) -> Stage:
    """Read a scene's meshes and textures from `FILES`; textures passed in `drawn` are not read."""
    kinds = ("vertices", "normals", "uv", "triangles")
    with np.load(FILES / f"{name}.npz") as data:
        table = data["meshes"]
        ends = {kind: table["triangles" if kind == "triangles" else "vertices"].cumsum() for kind in kinds}
        shapes = [np.split(data[kind], ends[kind]) for kind in kinds]
    meshes: dict[tuple[str, str], list[Mesh]] = {}
    for row, *shape in zip(table, *shapes, strict=False):
        mesh = Mesh(texture=str(row["texture"]), **dict(zip(kinds, shape, strict=True)))
        meshes.setdefault((str(row["part"]), str(row["thing"])), []).append(mesh)
    parts = {name: Part(thing, own) for (name, thing), own in meshes.items() if name}
    fixtures = [Part(thing, own) for (name, thing), own in meshes.items() if not name]
    textures = set(table["texture"].tolist()) - set(drawn)
    pictures = {one: np.asarray(cv2.imread(str(FILES / f"{one}.webp")), np.uint8) for one in textures}
    return Stage(fixtures, parts, pictures | drawn)
