"""A mesh of the fused cloud, cut where no points support it, and a picture of it from six places."""

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
"""Halvings of the cloud's box: 2^9 cells along its longest side."""
SHOWN_POISSON_DEPTH = 8
"""Halvings for a mesh that is only drawn, small."""
MAX_DISTANCE_SPACINGS = 4.0
"""The mesh is cut off where the cloud is farther away than this many times the distance of its points."""
MAX_MESH_POINTS = 400_000
TURNS_DEG = (-50, -30, -10, 10, 30, 50)
ALL_ROUND_DEG = (0, 60, 120, 180, 240, 300)
AROUND = 0.6
"""Cameras stand around the scene where the mean of the unit vectors towards them is no longer than this."""
FRAME_PX = (480, 360)


def build_mesh(
    fused: Path, folder: Path, views: Sequence[View], *, mesh: bool = True
) -> tuple[int, int, tuple[str, ...]]:
    """Clean the fused cloud, mesh it, and write cloud.ply, mesh.ply and turntable.png into the folder.

    Returns how many points and triangles are left, and the files' names.

    A cloud of too few points has no mesh, and no picture of it; none has where there is to be no `mesh`.

    `views`: the cameras, from whose side it is shown.

    Raises:
        OSError: a file could not be written.
    """
    o3d = load_open3d()
    with foreign_calls("Open3D", "making a mesh"):
        cloud = _drop_outliers(o3d.io.read_point_cloud(str(fused)))
        made = _poisson_mesh(o3d, cloud) if mesh else o3d.geometry.TriangleMesh()
        written = o3d.io.write_point_cloud(str(folder / "cloud.ply"), cloud)
        # Of a few points there is no mesh, and Open3D refuses to write one.
        if len(made.triangles):
            written &= o3d.io.write_triangle_mesh(str(folder / "mesh.ply"), made)
    if not written:
        raise OSError(f"cannot write the cloud and the mesh into {folder}")
    if not len(made.triangles):
        return len(cloud.points), 0, ("cloud.ply",)
    write_image(folder / "turntable.png", turntable(o3d, made, views))
    return len(cloud.points), len(made.triangles), ("cloud.ply", "mesh.ply", "turntable.png")


def draw_turntables(
    clouds: Mapping[str, tuple[Array, Array, Array]], views: Sequence[View]
) -> dict[str, Array] | None:
    """Mesh clouds and draw each from the same six places, about the middle of the first.

    A cloud is points (n, 3) in the rig's frame, normals (n, 3) and colours (n, 3) uint8 RGB. None where the
    first gives no mesh.

    Raises:
        NotAvailableError: Open3D is not here.
    """
    o3d = load_open3d()
    with foreign_calls("Open3D", "making a mesh"):
        meshes = {}
        for name, (points, normals, colours) in clouds.items():
            cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points.astype(np.float64)))
            cloud.normals = o3d.utility.Vector3dVector(normals.astype(np.float64))
            cloud.colors = o3d.utility.Vector3dVector(colours / 255.0)
            meshes[name] = _poisson_mesh(o3d, _drop_outliers(cloud), SHOWN_POISSON_DEPTH)
        first = next(iter(meshes.values()))
        if not len(first.triangles):
            return None
        middle = np.median(np.asarray(first.vertices), axis=0)
        return {name: turntable(o3d, mesh, views, middle) for name, mesh in meshes.items()}


def turntable(o3d: Any, mesh: Any, views: Sequence[View], middle: Array | None = None) -> Array:
    """The mesh from six places on an arc about its middle, or all round, as one BGR picture of 3 x 2.

    `middle` (3,): another point to turn about.
    """
    width, height = FRAME_PX
    if not len(mesh.triangles):
        return np.full((2 * height, 3 * width, 3), 32, np.uint8)
    if middle is None:
        middle = np.median(np.asarray(mesh.vertices), axis=0)
    away = np.array([view.centre for view in views]) - middle
    distance = np.linalg.norm(away, axis=1, keepdims=True)
    towards = np.mean(away / np.maximum(distance, 1e-9), axis=0)
    turns = TURNS_DEG
    if np.linalg.norm(towards) < AROUND:
        # The cameras' mean place is in the midst of the scene: begin at one of them.
        towards, turns = away[0], ALL_ROUND_DEG
    start = towards / np.linalg.norm(towards) * 1.15 * float(np.median(distance))
    up = up_direction([view.rotation for view in views])
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(mesh))
    colours = np.asarray(mesh.vertex_colors)[np.asarray(mesh.triangles)]

    def render(turn_deg: float) -> Array:
        """The mesh seen from the cameras' side after a turn about the vertical through the scene's middle."""
        turn, _ = cv2.Rodrigues(up * np.radians(turn_deg))
        eye = middle + turn @ start
        # Open3D's `up` is where the rows of its picture grow to.
        rays = scene.create_rays_pinhole(
            fov_deg=65.0, center=middle, eye=eye, up=-up, width_px=width, height_px=height
        )
        hits = scene.cast_rays(rays)
        there = np.isfinite(hits["t_hit"].numpy())
        u, v = hits["primitive_uvs"].numpy()[there].T[:, :, None]
        corners = colours[hits["primitive_ids"].numpy()[there]]
        rgb = corners[:, 0] * (1 - u - v) + corners[:, 1] * u + corners[:, 2] * v
        picture = np.full((height, width, 3), 32, np.uint8)
        picture[there] = np.clip(rgb[:, ::-1] * 255, 0, 255)
        return picture

    frames = [render(turn_deg) for turn_deg in turns]
    return np.concatenate([np.concatenate(frames[:3], axis=1), np.concatenate(frames[3:], axis=1)])


def _drop_outliers(cloud: Any) -> Any:
    """Points far from their neighbours are dropped; normals stay those of the views."""
    if len(cloud.points) <= NEIGHBOURS:
        return cloud
    return cloud.remove_statistical_outlier(NEIGHBOURS, 2.5)[0]


def _poisson_mesh(o3d: Any, cloud: Any, max_depth: int = MAX_POISSON_DEPTH) -> Any:
    if len(cloud.points) < 100:
        return o3d.geometry.TriangleMesh()
    if len(cloud.points) > MAX_MESH_POINTS:
        cloud = cloud.random_down_sample(MAX_MESH_POINTS / len(cloud.points))
    spacing = float(np.median(np.asarray(cloud.compute_nearest_neighbor_distance())))
    side = float(np.max(cloud.get_max_bound() - cloud.get_min_bound()))
    depth = int(np.clip(np.ceil(np.log2(side / max(2 * spacing, 1e-9))), 5, max_depth))
    mesh, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(cloud, depth=depth, n_threads=-1)
    vertices = o3d.geometry.PointCloud(mesh.vertices)
    away = np.asarray(vertices.compute_point_cloud_distance(cloud))
    # Poisson closes every surface: what no point supports would be invented.
    mesh.remove_vertices_by_mask(away > MAX_DISTANCE_SPACINGS * max(spacing, side / 2**depth))
    mesh.remove_unreferenced_vertices()
    return mesh


def up_direction(rotations: Sequence[Array]) -> Array:
    """What is up in most pictures of cameras with these `cam_from_rig` rotations, in the rig's frame (3,).

    The line that their columns are most along: a camera that hangs upside down is along it too.
    """
    down = np.array([rotation[1] for rotation in rotations])
    axis = np.linalg.eigh(down.T @ down)[1][:, -1]
    return np.asarray(axis if np.sum(np.sign(down @ axis)) < 0 else -axis)
