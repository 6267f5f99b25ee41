"""The painted street of a rig on a car, rendered: rays cast at bricks, planks and plaster in the sun."""

from dataclasses import dataclass
from functools import cache, cached_property

import cv2
import numpy as np

from benchmarks.reconstruction.painted_scenes import Stage, street
from benchmarks.scenery import materials
from benchmarks.scenery.meshes import panel
from capture_app.simulation.rendering import layers as still
from capture_app.simulation.rendering.raycast import Body, Texture, bundle_rays
from capture_app.simulation.rendering.scene import develop
from reconstruction.common.geometry import Array, View

EXPOSURE_NS, SAMPLES = 2_000_000, 2
SUN = np.array([0.5, -0.7, -0.5])
TEXTURE_M = 6.0
"""What a texture's width shows of a wall."""


@dataclass(frozen=True)
class RenderedStage(Stage):
    """A stage of boards that stand still, seen by rays; its balls are not."""

    @cached_property
    def body(self) -> Body:
        """All boards, each with a part of one of the materials."""
        meshes, pictures = [], _pictures()
        for board in self.boards:
            rng = np.random.default_rng(board.seed)
            wide, high = (float(np.linalg.norm(edge)) / TEXTURE_M for edge in (board.right, board.down))
            left, top = rng.uniform(0, 1, 2)
            name = str(rng.choice(sorted(pictures)))
            window = (left, top, left + wide, top + high)
            meshes.append(panel(board.corner, board.right, board.down, name, window=window))
        return Body(meshes, pictures)

    def look(self, view: View, time_s: float, noise: np.random.Generator) -> Array:
        """As `Stage.look`."""
        view = self.placed(view, time_s)
        camera = still.View("", view.width, view.height, view.focal, view.rotation, view.translation)
        light = np.zeros((view.height * view.width, 3), np.float32)
        for right, down in still.SUBPIXELS[:SAMPLES]:
            rays = bundle_rays(camera.centre, camera.directions(right, down))
            hits = self.body.cast(rays)
            met = np.flatnonzero(np.isfinite(hits.distance))
            footprint = hits.distance[met] / (2 * view.focal)
            colour, normals = self.body.surface_at(hits.select(met), rays[met, 3:], footprint)
            shade = 0.35 + 0.65 * np.clip(normals @ SUN.astype(np.float32), 0, 1)
            light[np.setdiff1d(np.arange(len(light)), met)] += 0.7
            light[met] += colour * shade[:, None]
        seen = light.reshape(view.height, view.width, 3) / np.float32(SAMPLES)
        picture = develop(seen, EXPOSURE_NS, noise)
        return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY))


@cache
def _pictures() -> dict[str, Texture]:
    rng = np.random.default_rng(3)
    return {
        "bricks": Texture(materials.bricks(rng, (900, 900), brick=(18, 44))),
        "stones": Texture(materials.bricks(rng, (900, 900), brick=(60, 110))),
        "planks": Texture(materials.planks(rng, (900, 900), (178, 126, 80), width=45, length=300)),
        "plaster": Texture(materials.plain(rng, (900, 900), (186, 170, 150), rough=0.25)),
    }


def rendered_street(seed: int) -> RenderedStage:
    """The painted street of the same seed."""
    painted = street(seed)
    return RenderedStage(painted.boards, rig_path=painted.rig_path)
