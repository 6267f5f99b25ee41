"""Triangle meshes with texture coordinates; every shape is made of sheets, i.e. grids of points.

Axes as in OpenCV's camera: x right, y down, z away from the viewer; metres.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from capture_app.plugins.cameras.sim.scenes import stages

Window = tuple[float, float, float, float]
"""A part of a texture: left, top, right, bottom in texture widths and heights; above 1 it repeats."""

WHOLE: Window = (0.0, 0.0, 1.0, 1.0)


@dataclass(frozen=True)
class Mesh(stages.Mesh):
    """A mesh that can still be moved."""

    def moved(self, offset: ArrayLike = (0.0, 0.0, 0.0), rotation: ArrayLike | None = None) -> "Mesh":
        """Return the mesh rotated by `rotation` (3x3) about the origin, then shifted by `offset` in m."""
        turn = np.eye(3, dtype=np.float32) if rotation is None else np.asarray(rotation, np.float32)
        vertices = self.vertices @ turn.T + np.asarray(offset, np.float32)
        return replace(self, vertices=vertices, normals=self.normals @ turn.T)


def sheet(points: ArrayLike, texture: str, *, window: Window = WHOLE, closed: bool = False) -> Mesh:
    """Return a smooth mesh of a grid of points (rows, columns, 3) in m, with the texture's window over it.

    `closed` means that the last column coincides with the first, so that normals are continuous across the
    seam.
    """
    grid = np.asarray(points, np.float64)
    rows, columns = grid.shape[:2]
    down = np.gradient(grid, axis=0)
    if closed:
        ring = grid[:, :-1]
        across = (np.roll(ring, -1, axis=1) - np.roll(ring, 1, axis=1)) / 2
        across = np.concatenate([across, across[:, :1]], axis=1)
    else:
        across = np.gradient(grid, axis=1)
    normals = np.cross(across, down)
    normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-12)
    left, top, right, bottom = window
    u, v = np.meshgrid(np.linspace(left, right, columns), np.linspace(top, bottom, rows))
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    triangles = np.concatenate(
        [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)]
    )
    return Mesh(
        vertices=grid.reshape(-1, 3).astype(np.float32),
        normals=normals.reshape(-1, 3).astype(np.float32),
        uv=np.stack([u, v], -1).reshape(-1, 2).astype(np.float32),
        triangles=triangles,
        texture=texture,
    )


def panel(
    corner: ArrayLike, right: ArrayLike, down: ArrayLike, texture: str, *, window: Window = WHOLE
) -> Mesh:
    """Return a flat rectangle from its top left corner along two edges, all in m."""
    start, u, v = (np.asarray(x, np.float64) for x in (corner, right, down))
    return sheet([[start, start + u], [start + v, start + u + v]], texture, window=window)


def box(centre: ArrayLike, size: ArrayLike, texture: str, *, window: Window = WHOLE) -> list[Mesh]:
    """Return the six faces of a box; each shows the window of the texture."""
    half = np.asarray(size, np.float64) / 2
    middle = np.asarray(centre, np.float64)
    faces = []
    for normal_axis, right_axis, down_axis in ((2, 0, 1), (0, 2, 1), (1, 0, 2)):
        for sign in (-1.0, 1.0):
            right, down, corner = np.zeros(3), np.zeros(3), middle.copy()
            corner[normal_axis] += sign * half[normal_axis]
            corner[right_axis] -= half[right_axis]
            corner[down_axis] -= half[down_axis]
            right[right_axis] = 2 * half[right_axis]
            down[down_axis] = 2 * half[down_axis]
            faces.append(panel(corner, right, down, texture, window=window))
    return faces


def lathe(
    profile: Sequence[tuple[float, float]],
    texture: str,
    *,
    depth: float = 1.0,
    around: int = 28,
    window: Window = WHOLE,
) -> Mesh:
    """Return a surface of revolution about the y axis from (radius, y) pairs from the top down, in m.

    `depth` scales it along z. The middle of the texture faces the viewer (-z).
    """
    radius, y = np.array(profile, np.float64).T
    angle = np.linspace(0.0, 2 * np.pi, around + 1)
    x, z = -radius[:, None] * np.sin(angle), depth * radius[:, None] * np.cos(angle)
    points = np.stack([x, np.broadcast_to(y[:, None], (len(y), around + 1)), z], axis=-1)
    return sheet(points, texture, window=window, closed=True)


def ellipsoid(radii: ArrayLike, texture: str, *, around: int = 28, window: Window = WHOLE) -> Mesh:
    """Return an ellipsoid about the origin with radii along x, y and z in m."""
    rx, ry, rz = (float(r) for r in np.asarray(radii, np.float64))
    angle = np.linspace(0.01, np.pi - 0.01, max(around // 2, 6))
    profile = [(rx * float(np.sin(a)), -ry * float(np.cos(a))) for a in angle]
    return lathe(profile, texture, depth=rz / rx, around=around, window=window)


def rod(start: ArrayLike, end: ArrayLike, radius: float, texture: str, *, around: int = 12) -> Mesh:
    """Return a straight round rod between two points in m."""
    a, b = np.asarray(start, np.float64), np.asarray(end, np.float64)
    along = (b - a) / np.linalg.norm(b - a)
    side = np.cross(along, [0.0, 0.0, 1.0] if abs(along[2]) < 0.9 else [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    turn = np.stack([side, along, np.cross(side, along)], axis=1)
    length = float(np.linalg.norm(b - a))
    return lathe([(radius, 0.0), (radius, length)], texture, around=around).moved(a, turn)
