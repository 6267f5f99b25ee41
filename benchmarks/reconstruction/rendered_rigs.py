"""Rigs of every kind around one object of the package's own renderer, with exact truth.

The object stands on the origin, 0.6 m tall; y points down. It is a vase, a crate and a ball on a table in a
room. In front of black, as objects are often photographed, it is a temple with equal columns, or a figure
with two faces, of which opposite cameras take the same image.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import cv2
import numpy as np

from benchmarks.scenery import materials
from benchmarks.scenery.meshes import Mesh, box, ellipsoid, lathe, rod
from capture_app.plugins.cameras.sim.rendering import layers as still
from capture_app.plugins.cameras.sim.rendering.layers import View as RenderedView
from capture_app.plugins.cameras.sim.rendering.raycast import LINEAR, Body, Texture
from capture_app.plugins.cameras.sim.rendering.scene import develop
from capture_app.plugins.cameras.sim.scenes.moving_bodies import rotation
from reconstruction.common.geometry import Array, View, look_along
from reconstruction.common.native_libraries import load_open3d

AIM = np.array([0.0, -0.28, 0.0])
"""The centre of the object."""
SIZE_M = 0.6
AROUND_M = 0.5
"""Radius around the centre inside which everything belongs to the object."""
OBJECT, SURROUNDINGS = 1, 0
EXPOSURE_NS = 4_000_000


class Placed(NamedTuple):
    """A camera: direction from the object's centre (azimuth, elevation in degrees), distance, lens, image."""

    round_deg: float
    up_deg: float
    away_m: float
    focal_px: float = 400.0
    size: tuple[int, int] = (320, 240)
    roll_deg: float = 0.0
    aside_m: float = 0.0
    """Shift to its own right, without rotation."""


class Rig(NamedTuple):
    """A kind of rig, and its object."""

    cameras: tuple[Placed, ...]
    shows: str = "still life"
    turned: bool = False
    """The object is on a turntable in front of one camera; a dim cloth behind it is equal in all images."""


def ring(count: int, **changes: Any) -> tuple[Placed, ...]:
    """Return cameras in a circle around the object."""
    usual = {"up_deg": 22.0, "away_m": 1.3} | changes
    return tuple(Placed(360 * number / count, **usual) for number in range(count))


RIGS: dict[str, Rig] = {
    "pair": Rig((Placed(-4, 8, 1.5), Placed(4, 8, 1.5))),
    "array": Rig(tuple(Placed(0, 8, 1.5, aside_m=0.12 * k) for k in (-2, -1, 0, 1, 2))),
    "ring of 12": Rig(ring(12)),
    "ring of 16": Rig(ring(16)),
    "ring of 16, temple": Rig(ring(16, away_m=2.6, focal_px=760.0), shows="temple"),
    "ring of 47, temple": Rig(ring(47, up_deg=4.0, away_m=2.6, focal_px=760.0), shows="temple"),
    **{
        f"ring of {count}, two faces": Rig(
            ring(count, up_deg=up_deg, away_m=2.6, focal_px=760.0), shows="two faces", turned=True
        )
        for count, up_deg in ((12, 22.0), (16, 22.0), (47, 4.0))
    },
    "dome": Rig(
        ring(14, up_deg=10.0) + ring(11, up_deg=36.0) + ring(6, up_deg=60.0) + (Placed(0, 88, 1.3),)
    ),
    "two opposite, helpers": Rig(tuple(Placed(a, 12, 1.3) for a in (-7, 7, 173, 187))),
    "mixed sizes": Rig(
        (
            Placed(-22, 10, 1.3),
            Placed(-11, 16, 1.6, 720.0, (480, 360)),
            Placed(0, 10, 1.2, 320.0, (240, 320)),
            Placed(11, 14, 2.2, 640.0),
            Placed(22, 10, 1.3, 260.0, (200, 150)),
        )
    ),
    "upside down": Rig(
        tuple(Placed(12.0 * k, 12, 1.3, roll_deg=(0, 180, 0, 90, 0)[k + 2]) for k in range(-2, 3))
    ),
}  # fmt: skip


@dataclass(frozen=True)
class RenderedRig:
    """Images (uint8), true depth (m, 0 = none) and the object's pixels (bool) by camera."""

    name: str
    views: dict[str, View]
    pictures: dict[str, Array]
    depth: dict[str, Array]
    object_mask: dict[str, Array]
    meshes: list[Mesh]

    def distance_m(self, points: Array) -> Array:
        """Return the distances of points (n, 3) from the nearest true surface, in m."""
        o3d = load_open3d()
        scene = o3d.t.geometry.RaycastingScene()
        for mesh in self.meshes:
            scene.add_triangles(
                o3d.core.Tensor(np.ascontiguousarray(mesh.vertices, np.float32)),
                o3d.core.Tensor(mesh.triangles.astype(np.uint32)),
            )
        return np.asarray(scene.compute_distance(o3d.core.Tensor(points.astype(np.float32))).numpy())


def render_rig(name: str, rig: Rig, *, scale: float = 1.0, samples: int = 2) -> RenderedRig:
    """Render all images and truths of a rig, at `scale`, with `samples` (1 to 4) of each pixel."""
    stage, meshes, things = make_stage(rig.shows)
    rendered = RenderedRig(name, {}, {}, {}, {}, meshes)
    for number, placed in enumerate(rig.cameras):
        camera = f"cam{number:02d}"
        view = place_view(camera, placed, scale)
        light = light_of(view, stage, samples)
        depth, thing = still.cast_depth(view, stage, view.directions())
        if rig.turned:
            light = np.where((things[thing] == OBJECT)[..., None], light, _cloth(*depth.shape))
        rendered.pictures[camera] = develop(light, EXPOSURE_NS, np.random.default_rng(number))
        rendered.depth[camera] = depth
        rendered.object_mask[camera] = things[thing] == OBJECT
        matrix = view.calibration().matrix(view.width, view.height)
        rendered.views[camera] = View(
            view.width, view.height, matrix, np.zeros(5), view.rotation, view.translation
        )
    return rendered


@cache
def _cloth(height: int, width: int) -> Array:
    """Return the cloth's light, of an image's size."""
    rng = np.random.default_rng(9)
    picture = materials.plain(rng, (240, 320), (52, 56, 60), rough=0.3)
    return np.asarray(cv2.resize(LINEAR[picture], (width, height), interpolation=cv2.INTER_AREA))


def light_of(view: RenderedView, stage: Body, samples: int) -> Array:
    """Return the light that a camera sees (H, W, 3), the mean of `samples` (1 to 4) of each pixel."""
    layers = [still.still_layer(view, stage, number) for number in range(samples)]
    return np.asarray(
        np.sum([layer.from_sky + layer.from_sun for layer in layers], axis=0) / np.float32(samples)
    )


def place_view(name: str, placed: Placed, scale: float) -> RenderedView:
    """Return the renderer's camera at a place, with images of its size times `scale`."""
    round_, up = np.radians([placed.round_deg, placed.up_deg])
    ahead = np.array([np.sin(round_) * np.cos(up), np.sin(up), np.cos(round_) * np.cos(up)])
    rotation = look_along(ahead, np.array([0.0, 1.0, 0.0]))
    centre = AIM - placed.away_m * ahead + placed.aside_m * rotation[0]
    rotation = cv2.Rodrigues(np.array([0, 0, np.radians(placed.roll_deg)]))[0] @ rotation
    width, height = (round(side * scale) for side in placed.size)
    return RenderedView(name, width, height, placed.focal_px * scale, rotation, -rotation @ centre)


@cache
def make_stage(shows: str) -> tuple[Body, list[Mesh], Array]:
    """Return the rendered body, its meshes, and for each object index whether it is the measured object."""
    rng = np.random.default_rng(5)
    pictures = {
        "stone": materials.plain(rng, (500, 500), (188, 176, 156), rough=0.16),
        "column": materials.plain(rng, (160, 220), (196, 184, 160), rough=0.12),
        "carpet": materials.kilim(rng, (420, 760)),
        "clay": materials.plain(rng, (300, 700), (176, 104, 76), rough=0.2),
        "crate": materials.planks(rng, (300, 300), (186, 150, 104), width=50, length=300),
        "table": materials.planks(rng, (900, 900), (178, 126, 80), width=60, length=420),
        "wall": materials.bricks(rng, (700, 1400), brick=(24, 62)),
        "black": np.full((8, 8, 3), 3, np.uint8),
    }
    things = [(OBJECT, OBJECTS[shows]()), (SURROUNDINGS, _surroundings(shows))]
    meshes = [mesh for _, group in things for mesh in group]
    numbers = [number for number, (_, group) in enumerate(things) for _ in group]
    body = Body(meshes, {name: Texture(picture) for name, picture in pictures.items()}, numbers)
    return body, meshes, np.array([which for which, _ in things])


def _still_life() -> list[Mesh]:
    """Return round and flat objects, some in front of others."""
    profile = [(0.05, -0.60), (0.065, -0.57), (0.045, -0.52), (0.10, -0.42), (0.135, -0.32), (0.13, -0.2)]
    vase = lathe([*profile, (0.09, -0.08), (0.075, -0.03)], "carpet", around=48)
    meshes = [vase, *box((0, -0.015, 0), (0.62, 0.03, 0.52), "stone")]
    meshes += [
        part.moved((-0.17, -0.16, -0.08), rotation(1, 0.5))
        for part in box((0, 0, 0), (0.2, 0.26, 0.2), "crate")
    ]
    meshes.append(ellipsoid((0.1, 0.1, 0.1), "clay", around=36).moved((0.17, -0.13, -0.1)))
    meshes.append(ellipsoid((0.07, 0.12, 0.07), "stone", around=36).moved((0.1, -0.15, 0.16)))
    return meshes


def _temple() -> list[Mesh]:
    """Return flat faces, and equal columns."""
    meshes = box((0, -0.03, 0), (0.46, 0.06, 0.36), "stone")
    meshes += box((0, -0.085, 0), (0.40, 0.05, 0.30), "stone")
    for x in (-0.15, -0.05, 0.05, 0.15):
        for z in (-0.10, 0.10):
            meshes.append(rod((x, -0.42, z), (x, -0.11, z), 0.026, "column", around=20))
    meshes += box((0, -0.445, 0), (0.40, 0.05, 0.30), "stone")
    meshes.append(lathe([(0.02, -0.60), (0.14, -0.53), (0.16, -0.47)], "stone", around=32))
    return meshes


def _two_faces() -> list[Mesh]:
    """Return a slab and a head on a foot, which look equal after half a turn."""
    half = [box((0, -0.27, -0.02), (0.34, 0.26, 0.04), "carpet")[0]]
    half.append(ellipsoid((0.03, 0.05, 0.04), "clay", around=24).moved((0.06, -0.27, -0.04)))
    half.append(ellipsoid((0.018, 0.018, 0.03), "stone", around=24).moved((-0.035, -0.53, -0.08)))
    half.append(rod((0.19, -0.42, -0.03), (0.19, -0.12, -0.03), 0.022, "column", around=20))
    profile = [(0.02, -0.60), (0.075, -0.57), (0.095, -0.51), (0.07, -0.44), (0.04, -0.40)]
    whole = [lathe(profile, "clay", around=48, window=(0.0, 0.0, 2.0, 1.0))]
    whole += box((0, -0.27, 0), (0.34, 0.26, 0.04), "stone")[2:]
    whole.append(lathe([(0.02, -0.14), (0.16, -0.12), (0.2, 0.0)], "stone", window=(0.0, 0.0, 2.0, 1.0)))
    return whole + [part.moved((0, 0, 0), rotation(1, np.pi * side)) for side in (0, 1) for part in half]


OBJECTS = {"still life": _still_life, "temple": _temple, "two faces": _two_faces}


def _surroundings(shows: str) -> list[Mesh]:
    if shows != "still life":
        return box((0, 0, 0), (16, 16, 16), "black")
    meshes = box((0, 0.02, 0), (1.3, 0.04, 1.3), "table")
    return meshes + box((0, -0.3, 0), (5.0, 2.6, 5.0), "wall")
