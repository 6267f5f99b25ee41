"""Mesh of the fused point cloud, cut where no points support it, and views of clouds from six places."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from reconstruction.common.geometry import Array, View
from reconstruction.common.image_files import write_image
from reconstruction.common.native_libraries import foreign_calls, load_open3d

NEIGHBOURS = 16
MAX_POISSON_DEPTH = 9
"""Maximum octree depth: 2^9 cells along the longest side of the cloud's box."""
MAX_DISTANCE_SPACINGS = 4.0
"""Maximum distance of the mesh from the cloud, in units of the points' spacing; beyond it is removed."""
MAX_MESH_POINTS = 400_000
MAX_SHOWN_POINTS = 150_000
TURNS_DEG = (-50, -30, -10, 10, 30, 50)
ALL_ROUND_DEG = (0, 60, 120, 180, 240, 300)
AROUND = 0.6
"""Maximum length of the mean unit vector towards the cameras if they surround the scene."""
FRAME_PX, WIDE_DEG, GROUND_GREY = (480, 360), 65.0, 32


def build_mesh(
    fused: Path, folder: Path, views: Sequence[View], *, mesh: bool = True
) -> tuple[int, int, tuple[str, ...]]:
    """Clean the fused cloud, mesh it, and write cloud.ply, mesh.ply and turntable.png into the folder.

    Returns the remaining numbers of points and triangles, and the files' names.

    A cloud of too few points gives no mesh and no picture, nor does `mesh` False.

    `views`: the cameras; the pictures are taken from their side.

    Raises:
        OSError: a file could not be written.
    """
    o3d = load_open3d()
    with foreign_calls("Open3D", "making a mesh"):
        cloud = _drop_outliers(o3d.io.read_point_cloud(str(fused)))
        made = _poisson_mesh(o3d, cloud) if mesh else o3d.geometry.TriangleMesh()
        written = o3d.io.write_point_cloud(str(folder / "cloud.ply"), cloud)
        # A few points give no mesh, and Open3D refuses to write an empty one.
        if len(made.triangles):
            written &= o3d.io.write_triangle_mesh(str(folder / "mesh.ply"), made)
    if not written:
        raise OSError(f"cannot write the cloud and the mesh into {folder}")
    if not len(made.triangles):
        return len(cloud.points), 0, ("cloud.ply",)
    points, colours = np.asarray(cloud.points), np.rint(255 * np.asarray(cloud.colors)).astype(np.uint8)
    write_image(folder / "turntable.png", draw_clouds({"": (points, colours)}, views)[""])
    return len(cloud.points), len(made.triangles), ("cloud.ply", "mesh.ply", "turntable.png")


def draw_clouds(clouds: Mapping[str, tuple[Array, Array]], views: Sequence[View]) -> dict[str, Array]:
    """Draw each cloud from six viewpoints around the first cloud's centre, as one BGR picture of 3 x 2.

    A cloud is points (n, 3) in the rig's frame and colours (n, 3) uint8 RGB.
    """
    middle = np.median(next(iter(clouds.values()))[0], axis=0)
    eyes, up = _places_around(middle, views)
    drawn = {}
    for name, cloud in clouds.items():
        points, colours = (part[:: 1 + len(part) // MAX_SHOWN_POINTS] for part in cloud)
        frames = [_draw_points(points, colours, eye, middle, up) for eye in eyes]
        drawn[name] = np.vstack([np.hstack(frames[:3]), np.hstack(frames[3:])])
    return drawn


def _draw_points(points: Array, colours: Array, eye: Array, middle: Array, up: Array) -> Array:
    """Draw points as squares of 3 px, the nearest in front, as seen from `eye` towards `middle`."""
    width, height = FRAME_PX
    ahead = (middle - eye) / np.linalg.norm(middle - eye)
    right = np.cross(ahead, up)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(ahead, right), ahead]).astype(np.float32)
    seen = (points.astype(np.float32) - eye.astype(np.float32)) @ rotation.T
    nearer = np.argsort(-seen[:, 2])
    nearer = nearer[seen[nearer, 2] > 1e-9]
    flat = seen[nearer, :2] / seen[nearer, 2:] * (width / 2 / np.tan(np.radians(WIDE_DEG / 2)))
    at = np.rint(np.add(flat, (width / 2, height / 2))).astype(int)
    inside = ((at > 0) & (at < (width - 1, height - 1))).all(1)
    square = np.add.outer([-width, 0, width], [-1, 0, 1]).ravel()
    picture = np.full((height * width, 3), GROUND_GREY, np.uint8)
    # Later squares overwrite earlier ones.
    picture[(at[inside] @ (1, width))[:, None] + square] = colours[nearer[inside], None, ::-1]
    return picture.reshape(height, width, 3)


def _places_around(middle: Array, views: Sequence[View]) -> tuple[list[Array], Array]:
    """Return six viewpoints (3,) from which to draw a cloud, and the up direction (3,).

    They lie on the cameras' side of `middle`, or all around it if the cameras surround it.
    """
    offsets = np.array([view.centre for view in views]) - middle
    distance = np.linalg.norm(offsets, axis=1, keepdims=True)
    towards = np.mean(offsets / np.maximum(distance, 1e-9), axis=0)
    angles_deg = TURNS_DEG
    if np.linalg.norm(towards) < AROUND:
        # The cameras' mean position is within the scene: start at one of them.
        towards, angles_deg = offsets[0], ALL_ROUND_DEG
    start = towards / np.linalg.norm(towards) * 1.15 * float(np.median(distance))
    up = up_direction([view.rotation for view in views])
    return [middle + cv2.Rodrigues(up * np.radians(angle_deg))[0] @ start for angle_deg in angles_deg], up


def _drop_outliers(cloud: Any) -> Any:
    """Drop points far from their neighbours; normals remain as measured by the views."""
    if len(cloud.points) <= NEIGHBOURS:
        return cloud
    return cloud.remove_statistical_outlier(NEIGHBOURS, 2.5)[0]


def _poisson_mesh(o3d: Any, cloud: Any) -> Any:
    if len(cloud.points) < 100:
        return o3d.geometry.TriangleMesh()
    if len(cloud.points) > MAX_MESH_POINTS:
        cloud = cloud.random_down_sample(MAX_MESH_POINTS / len(cloud.points))
    spacing = float(np.median(np.asarray(cloud.compute_nearest_neighbor_distance())))
    side = float(np.max(cloud.get_max_bound() - cloud.get_min_bound()))
    depth = int(np.clip(np.ceil(np.log2(side / max(2 * spacing, 1e-9))), 5, MAX_POISSON_DEPTH))
    mesh, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(cloud, depth=depth, n_threads=-1)
    vertices = o3d.geometry.PointCloud(mesh.vertices)
    distance = np.asarray(vertices.compute_point_cloud_distance(cloud))
    # Poisson closes every surface: parts without supporting points are invented.
    mesh.remove_vertices_by_mask(distance > MAX_DISTANCE_SPACINGS * max(spacing, side / 2**depth))
    mesh.remove_unreferenced_vertices()
    return mesh


def up_direction(rotations: Sequence[Array]) -> Array:
    """Return the up direction (3,) of most images in the rig's frame, from `cam_from_rig` rotations.

    It is along the principal axis of the images' columns, which upside-down cameras share.
    """
    down = np.array([rotation[1] for rotation in rotations])
    axis = np.linalg.eigh(down.T @ down)[1][:, -1]
    return np.asarray(axis if np.sum(np.sign(down @ axis)) < 0 else -axis)
