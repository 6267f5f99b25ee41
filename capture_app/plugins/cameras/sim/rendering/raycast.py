"""Ray casting against a rigid body of textured triangles (Embree, on the CPU)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from capture_app.common.errors import NotAvailableError
from capture_app.common.srgb import to_linear
from capture_app.plugins.cameras.sim.scenes.stages import Floats, Mesh

LINEAR = to_linear(np.arange(256)).astype(np.float32)
"""Linear light of each grey level of sRGB."""


class Texture:
    """An image in linear light with its mipmaps, sampled by bilinear lookups in two levels."""

    def __init__(self, picture: NDArray[np.uint8]) -> None:
        level = LINEAR[picture]
        self.levels = [np.ascontiguousarray(level)]
        while min(level.shape[:2]) > 4:
            size = (max(level.shape[1] // 2, 1), max(level.shape[0] // 2, 1))
            level = cv2.resize(level, size, interpolation=cv2.INTER_AREA)
            self.levels.append(level)

    def sample(self, uv: Floats, lod: Floats) -> Floats:
        """Return linear BGR (N, 3) at texture coordinates (N, 2); `lod` is log2 of texels per sample (N)."""
        lod = np.clip(lod, 0.0, len(self.levels) - 1.001)
        low = lod.astype(np.int32)
        out = np.empty((len(uv), 3), np.float32)
        for number in np.unique(low):
            chosen = np.flatnonzero(low == number)
            blend, at = (lod[chosen] - number)[:, None], uv[chosen]
            out[chosen] = self._bilinear(number, at) * (1 - blend) + self._bilinear(number + 1, at) * blend
        return out

    def _bilinear(self, number: int, uv: Floats) -> Floats:
        level = self.levels[number]
        height, width = level.shape[:2]
        where = (uv - np.floor(uv)) * np.array([width, height], np.float32) - 0.5
        # cv2.remap takes maps of at most 32767 rows or columns, so fold the list into rows of 1024.
        folded = np.zeros((-(-len(where) // 1024) * 1024, 2), np.float32)
        folded[: len(where)] = where
        texture = cv2.remap(
            level, folded.reshape(-1, 1024, 2), None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP
        )
        return np.asarray(texture.reshape(-1, 3)[: len(where)], np.float32)


def bundle_rays(origins: Floats, directions: Floats) -> Floats:
    """Return rays (N, 6) with one origin (3) or one each (N, 3), and one direction or one each."""
    rays = np.empty((*np.broadcast_shapes(origins.shape, directions.shape)[:-1], 6), np.float32)
    rays[..., :3], rays[..., 3:] = origins, directions
    return rays.reshape(-1, 6)


def _parts(rays: Floats) -> tuple[Floats, Floats]:
    """Return the origins and the directions (N, 3) of rays (N, 6)."""
    return np.ascontiguousarray(rays[:, :3]), np.ascontiguousarray(rays[:, 3:])


def _embree_scene(vertices: Floats, triangles: NDArray[np.integer]) -> Any:
    try:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene
    except (ImportError, OSError) as error:
        raise NotAvailableError(
            f"a rendered scene needs embreex (Linux on x86-64), which does not load here: {error}",
            hint="use scene=bars",
        ) from error
    scene = EmbreeScene()
    TriangleMesh(scene, np.ascontiguousarray(vertices, np.float32), triangles.astype(np.int32))
    return scene


@dataclass(frozen=True)
class Hits:
    """Hits of rays: distance in ray lengths (inf: nothing), triangle, position in the triangle."""

    distance: Floats
    triangle: NDArray[np.int64]
    barycentric: Floats

    def select(self, chosen: NDArray[np.intp]) -> "Hits":
        """Return the hits of the chosen rays (indices) only."""
        return Hits(self.distance[chosen], self.triangle[chosen], self.barycentric[chosen])


class Body:
    """Meshes that move together, with textures by name; `things` gives each mesh's object number."""

    def __init__(
        self, meshes: Sequence[Mesh], textures: Mapping[str, Texture], things: Sequence[int] | None = None
    ) -> None:
        counts = np.cumsum([0, *(len(m.vertices) for m in meshes)])
        triangles = np.concatenate([m.triangles + start for m, start in zip(meshes, counts, strict=False)])
        vertices = np.concatenate([m.vertices for m in meshes])
        self._normals = np.concatenate([m.normals for m in meshes])[triangles]
        self._uv = np.concatenate([m.uv for m in meshes])[triangles]
        names = sorted({m.texture for m in meshes})
        self._textures = [textures[name] for name in names]
        lengths = [len(m.triangles) for m in meshes]
        self._texture = np.repeat([names.index(m.texture) for m in meshes], lengths)
        self.thing = np.repeat(np.asarray(things or [0] * len(meshes), np.uint8), lengths)
        self._texels_per_m = self._density(vertices[triangles])
        self.centre: Floats = (vertices.min(0) + vertices.max(0)) / 2
        self.radius = float(np.linalg.norm(vertices - self.centre, axis=1).max())
        """Radius in m of the sphere about `centre` that contains the body."""
        self._scene = _embree_scene(vertices, triangles)

    def _density(self, corners: Floats) -> Floats:
        sizes = np.array([t.levels[0].shape[1::-1] for t in self._textures], np.float32)[self._texture]
        texels = self._uv * sizes[:, None]
        a, b = texels[:, 1] - texels[:, 0], texels[:, 2] - texels[:, 0]
        texel_area = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        return np.asarray(np.sqrt(texel_area / np.maximum(area, 1e-9)), np.float32)

    def cast(self, rays: Floats) -> Hits:
        """Return the first triangle hit by each ray (N, 6): origin and direction in the body's frame, m."""
        hits = self._scene.run(*_parts(rays), query="INTERSECT", output=True)
        return Hits(
            distance=np.where(hits["primID"] < 0, np.inf, hits["tfar"]).astype(np.float32),
            triangle=hits["primID"].astype(np.int64),
            barycentric=np.stack([hits["u"], hits["v"]], axis=1),
        )

    def occludes(self, rays: Floats, *, near: float, far: float) -> NDArray[np.bool_]:
        """Return whether each ray (N, 6) hits the body between `near` and `far` ray lengths."""
        origins, directions = _parts(rays)
        depth_span = np.full(len(rays), far - near, np.float32)
        hits = self._scene.run(origins + near * directions, directions, dists=depth_span, query="OCCLUDED")
        return np.asarray(hits >= 0)

    def surface_at(self, hits: Hits, directions: Floats, footprint: Floats) -> tuple[Floats, Floats]:
        """Return linear BGR (N, 3) and the unit normal (N, 3) that faces the ray, for rays that hit the body.

        `footprint` (N) is the width in m of a sample on the surface, seen face on.
        """
        u, v = hits.barycentric.T
        weights = np.stack([1 - (u + v), u, v], axis=1)
        normal = np.einsum("nij,ni->nj", self._normals[hits.triangle], weights)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
        facing = np.einsum("ni,ni->n", normal, directions) / np.linalg.norm(directions, axis=1)
        normal = np.where(facing[:, None] > 0, -normal, normal)
        uv = np.einsum("nij,ni->nj", self._uv[hits.triangle], weights)
        # A slanted surface is compressed along one direction only, so blur by half of that, in octaves.
        stretched = footprint * self._texels_per_m[hits.triangle] / np.sqrt(np.maximum(np.abs(facing), 0.05))
        lod = np.log2(np.maximum(stretched, 1.0)).astype(np.float32)
        colour = np.empty((len(uv), 3), np.float32)
        texture = self._texture[hits.triangle]
        for number in np.unique(texture):
            chosen = np.flatnonzero(texture == number)
            colour[chosen] = self._textures[number].sample(uv[chosen], lod[chosen])
        return colour, normal.astype(np.float32)
