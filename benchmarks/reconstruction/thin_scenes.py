"""A room with upright rods before a wall of strong texture; and without them, with a fine texture."""

from functools import partial

import numpy as np

from benchmarks.reconstruction.blank_scenes import ROOM_CAMERAS
from benchmarks.scenery import materials
from benchmarks.scenery.meshes import Mesh, panel, rod
from capture_app.plugins.cameras.sim.scenes.stages import Part, Picture, SceneDefinition, SceneStage
from reconstruction.common.geometry import Array

SEED, RODS = 20261127, 7
COLOURS = (
    (38, 40, 44), (176, 58, 50), (92, 70, 52), (222, 214, 198), (60, 92, 140), (196, 160, 90), (116, 116, 112)
)  # fmt: skip
NEAR_M, FAR_M = 2.4, 4.3
"""Distances of the rods and of the wall."""
FOCAL_PX = 520.0
MIN_CONTRAST = 25.0
"""Minimum difference between a rod's picture and the wall behind it, of 255, mean of the colours."""
MIN_LENGTH = 0.7
"""Minimum part of a rod's length that shows more of the rod than of the wall."""


WEAVE, FINE_WEAVE = (9, 45), (5, 11)
"""Sizes of the wall's features in texels, 3.4 of which are a pixel."""


def _textures(rng: np.random.Generator, sizes: tuple[int, int]) -> dict[str, Picture]:
    shape = 1600, 2600
    fine, coarse = (materials.noise(rng, shape, (size, size)) for size in sizes)
    weave = fine + coarse
    wall = np.array([112.0, 122, 128]) + 34 * weave[..., None]
    return {
        "wall": np.clip(wall, 0, 255).astype(np.uint8),
        "floor": materials.bricks(rng, (900, 1500), brick=(60, 150)),
        **{f"rod {k}": materials.plain(rng, (400, 60), COLOURS[k], rough=0.06) for k in range(RODS)},
    }


def _stage(thickness_px: float, sizes: tuple[int, int]) -> SceneStage:
    rng = np.random.default_rng(SEED)
    radius = 0.5 * thickness_px * NEAR_M / FOCAL_PX
    bars: list[Mesh] = []
    for number in range(RODS if thickness_px else 0):
        x = -0.75 + 1.5 * number / (RODS - 1) + rng.uniform(-0.03, 0.03)
        z = NEAR_M + 0.08 * np.sin(number)
        bars.append(rod((x, 0.62, z), (x, -0.72, z), radius, f"rod {number}", around=8))
    walls = [
        panel((-3.2, -2.2, FAR_M), (6.4, 0, 0), (0, 3.6, 0), "wall"),
        panel((-3.2, 1.3, 1.0), (6.4, 0, 0), (0, 0, FAR_M - 1.0), "floor"),
    ]
    return SceneStage([Part("walls", walls), Part("rods", bars)], {}, _textures(rng, sizes))


def rods(thickness_px: float) -> SceneDefinition:
    """Return the room with rods of a thickness in the pictures of its cameras; 0 = without."""
    return SceneDefinition(ROOM_CAMERAS, partial(_stage, thickness_px, WEAVE), lambda _: {})


FINE_ROOM = SceneDefinition(ROOM_CAMERAS, partial(_stage, 0, FINE_WEAVE), lambda _: {})
"""The room without rods, with a fine texture on its wall."""


def count_rods(drawn: Array, truth: Array, without: Array, depth: Array) -> int:
    """Return how many rods a drawn picture shows: most of their length is more like them than like the wall.

    `truth` and `without` are the true pictures with and without rods, `depth` the true depth, m. Rods are
    upright, so that columns part them.
    """
    alike, behind = (np.asarray(one, float) - without for one in (drawn, truth))
    there = np.abs(behind).mean(axis=2) > MIN_CONTRAST
    there &= (depth > NEAR_M - 0.3) & (depth < NEAR_M + 0.3)
    columns = np.flatnonzero((depth < 0.8 * FAR_M)[: len(depth) // 2].sum(axis=0))
    found = 0
    for group in np.split(columns, np.flatnonzero(np.diff(columns) > 4) + 1):
        part = slice(group[0] - 2, group[-1] + 3)
        weight = there[:, part, None] * behind[:, part]
        rows = there[:, part].any(axis=1)
        shown = (weight * alike[:, part]).sum(axis=(1, 2))[rows] / (weight**2).sum(axis=(1, 2))[rows]
        found += bool(np.mean(shown > 0.5) >= MIN_LENGTH)
    return found
