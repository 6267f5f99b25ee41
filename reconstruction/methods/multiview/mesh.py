"""Cleaned cloud, mesh of the depth maps, cut at edges of depth, and views of clouds from six places."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import permutations
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from capture_app.common.gltf import Gltf
from capture_app.session.format.calibration import METRES
from reconstruction.common.geometry import Array, View, look_along
from reconstruction.common.image_files import write_image
from reconstruction.common.native_libraries import foreign_calls, load_open3d
from reconstruction.methods.multiview.fusion import SLACK, FusedCloud, find_denied, project_points
from reconstruction.methods.multiview.sweep_matcher import ViewDepth

MAX_JUMP = 0.006
"""Maximum relative difference of depths in a triangle, unless its corners are in one plane.

The same fraction of their depth is the maximum distance of the corners from each other's tangent planes. It
is larger across an edge of depth, but not on a surface that is seen at a grazing angle.
"""
MAX_WIDTH_PX = 960
"""Width of the grid of triangles in wider maps."""
MAX_SHOWN_POINTS = 150_000
"""Maximum number of points of a picture."""


def build_mesh(
    fused: FusedCloud,
    folder: Path,
    views: Mapping[str, View],
    depth_views: Mapping[str, ViewDepth],
    pictures: Mapping[str, Array],
    *,
    unit: str,
    mesh: bool = True,
) -> tuple[int, int, tuple[str, ...]]:
    """Clean the fused cloud, mesh the maps, and write cloud.ply, meshes and turntable.png into the folder.

    mesh.ply is in the rig's frame and its `unit`, mesh.glb upright and in metres if the unit is a length.
    Returns the remaining numbers of points and triangles, and the files' names.

    Maps of too few pixels give no mesh and no picture, nor does `mesh` False.

    `pictures`: the maps' images (uint8 BGR). turntable.png is drawn from the cameras' side.

    Raises:
        OSError: a file could not be written.
    """
    o3d = load_open3d()
    made = o3d.geometry.TriangleMesh()
    if mesh:
        vertices, painted, triangles = join_maps(views, depth_views, pictures)
        made.vertices = o3d.utility.Vector3dVector(vertices)
        made.vertex_colors = o3d.utility.Vector3dVector(painted / 255)
        made.triangles = o3d.utility.Vector3iVector(triangles)
    with foreign_calls("Open3D", "cleaning a cloud"):
        cloud = _drop_outliers(o3d, fused)
        written = o3d.io.write_point_cloud(str(folder / "cloud.ply"), cloud)
        # Open3D refuses to write an empty mesh.
        if len(made.triangles):
            written &= o3d.io.write_triangle_mesh(str(folder / "mesh.ply"), made)
            # glTF's y points up, the rig's down. Open3D's writer takes 200 MB for a mesh of 15.
            upright = vertices * (1, -1, -1) * METRES.get(unit, 1.0)
            write_glb(folder / "mesh.glb", upright, painted, triangles)
    if not written:
        raise OSError(f"cannot write the cloud and the mesh into {folder}")
    if not len(made.triangles):
        return len(cloud.points), 0, ("cloud.ply",)
    points, colours = np.asarray(cloud.points), np.rint(255 * np.asarray(cloud.colors)).astype(np.uint8)
    write_image(folder / "turntable.png", draw_clouds({"": (points, colours)}, list(views.values()))[""])
    return len(cloud.points), len(made.triangles), ("cloud.ply", "mesh.ply", "mesh.glb", "turntable.png")


def write_glb(path: Path, vertices: Array, colours: Array, triangles: Array) -> None:
    """Write a mesh as binary glTF 2.0: vertices (n, 3), colours (n, 3; uint8 RGB), triangles (m, 3)."""
    document = Gltf()
    attributes = {"POSITION": document.add_array("<f4", vertices), "COLOR_0": document.add_colours(colours)}
    # Without a material, Blender shows no colours.
    material = document.add("materials", pbrMetallicRoughness={"metallicFactor": 0.0})
    indices = document.add_array("<u4", triangles.reshape(-1, 1))
    surface = {"attributes": attributes, "indices": indices, "material": material}
    document.add("scenes", nodes=[document.add("nodes", mesh=document.add("meshes", primitives=[surface]))])
    path.write_bytes(document.encode_binary())


def join_maps(
    views: Mapping[str, View], depth_views: Mapping[str, ViewDepth], pictures: Mapping[str, Array]
) -> tuple[Array, Array, Array]:
    """Return a mesh of all maps: points (n, 3), colours (n, 3) uint8 RGB, and triangles (m, 3) of indices.

    Each map is triangulated on its pixels, without triangles across an edge of depth. What an earlier map's
    triangles contain is left out, except for a seam of one pixel. Points that other views deny
    (`find_denied`) and few confirm are left out. Each other point is the mean of the maps that measured it
    to within `SLACK`.
    """
    small = {name: _reduce(views[name], depth_views[name], pictures[name]) for name in depth_views}
    views = {name: view for name, (view, _, _) in small.items()}
    depth_views = {name: found for name, (_, found, _) in small.items()}
    taken: dict[str, Array] = {}
    parts, count = [], 0
    for name, (view, found, picture) in small.items():
        depth, mine = found.depth, found.depth > 0
        surface = view.unproject(view.grid(), depth.reshape(-1)).reshape(*depth.shape, 3)
        for other, covered in taken.items():
            pixels = np.nonzero(mine)
            at, ratio = _compare(surface[pixels], views[other], depth_views[other])
            mine[pixels] = (ratio == 0) | ~covered.take(at)
        seam = cv2.dilate(mine.astype(np.uint8), np.ones((3, 3), np.uint8))
        pixels = np.nonzero((depth > 0) & (seam > 0))
        points = surface[pixels]
        ratios = [np.zeros(len(points))]  # There may be no other map.
        ratios += [_compare(points, views[other], depth_views[other])[1] for other in small if other != name]
        normals = found.normals[pixels] @ view.rotation
        denied = find_denied(points, normals, views, depth_views)
        # Maps that measured this surface with a larger error would deny it.
        # Two other maps of its surface keep a point, whatever further views measured.
        denied &= np.count_nonzero(ratios, axis=0) < 2
        # A point moved by more than SLACK would contradict its own map.
        ratios = [np.where(np.abs(ratio - 1) < SLACK, ratio, 0) for ratio in ratios]
        mean = (1 + np.sum(ratios, axis=0)) / (1 + np.count_nonzero(ratios, axis=0))
        points = view.centre + (points - view.centre) * mean[:, None]
        index = np.full(depth.shape, -1)
        index[pixels] = np.where(denied, -1, np.arange(len(points)))
        corners = np.stack([index[:-1, :-1], index[1:, :-1], index[:-1, 1:], index[1:, 1:]], axis=-1)
        triangles = corners[..., [0, 1, 2, 2, 1, 3]].reshape(-1, 3)
        triangles = triangles[(triangles >= 0).all(1)]
        z = depth[pixels][triangles.T]
        whole = np.ptp(z, axis=0) < MAX_JUMP * z.min(0)
        steep = triangles[~whole]
        off_plane = _max_off_plane(points[steep], normals[steep])
        whole[~whole] = off_plane < MAX_JUMP * z[:, ~whole].min(0)
        triangles = triangles[whole]
        # What this map shows but no triangle of it contains is left to the others.
        used = np.isin(np.arange(len(points)), triangles)
        taken[name] = np.zeros_like(mine)
        taken[name][pixels] = used & mine[pixels]
        parts.append((points, picture[pixels][:, ::-1], triangles + count))
        count += len(points)
    points, colours, triangles = (np.concatenate(part) for part in zip(*parts, strict=True))
    used = np.isin(np.arange(count), triangles)
    return points[used], colours[used], (np.cumsum(used) - 1)[triangles]


def _max_off_plane(corners: Array, normals: Array) -> Array:
    """Return the largest distance (m,) of triangles' corners from each other's tangent planes.

    `corners` and unit `normals` are (m, 3, 3).
    """
    off = (
        np.einsum("ij,ij->i", corners[:, other] - corners[:, first], normals[:, first])
        for first, other in permutations(range(3), 2)
    )
    return np.asarray(np.max(np.abs([*off]), axis=0))


def _reduce(view: View, found: ViewDepth, picture: Array) -> tuple[View, ViewDepth, Array]:
    """Return every second or n-th pixel of a map wider than `MAX_WIDTH_PX`, with its view and picture."""
    step = max(1, round(view.width / MAX_WIDTH_PX))
    depth, normals, colours = (part[::step, ::step] for part in (found.depth, found.normals, picture))
    height, width = depth.shape
    small = replace(view, width=width, height=height, matrix=np.diag([1 / step, 1 / step, 1]) @ view.matrix)
    return small, ViewDepth(depth, normals), colours


def _compare(points: Array, view: View, found: ViewDepth) -> tuple[Array, Array]:
    """Return the pixels (flat indices) at which a view sees points, and its depths relative to theirs.

    The relative depth is 0 where the view did not measure that surface.
    """
    at, z, inside = project_points(view, points)
    ratio = found.depth.take(at) / np.where(inside, z, 1)
    # Two views' depths of one surface differ by less.
    return at, np.where(inside & (np.abs(ratio - 1) < 0.015), ratio, 0)


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
    """Draw points as squares of 3 px, the nearest in front, as seen from `eye` towards `middle`.

    The view is 65 degrees wide, its ground dark.
    """
    width, height = 480, 360
    ahead = (middle - eye) / np.linalg.norm(middle - eye)
    rotation = look_along(ahead, -up).astype(np.float32)
    seen = (points.astype(np.float32) - eye.astype(np.float32)) @ rotation.T
    nearer = np.argsort(-seen[:, 2])
    nearer = nearer[seen[nearer, 2] > 1e-9]
    flat = seen[nearer, :2] / seen[nearer, 2:] * (width / 2 / np.tan(np.radians(65 / 2)))
    at = np.rint(np.add(flat, (width / 2, height / 2))).astype(int)
    inside = ((at > 0) & (at < (width - 1, height - 1))).all(1)
    square = np.add.outer([-width, 0, width], [-1, 0, 1]).ravel()
    picture = np.full((height * width, 3), 32, np.uint8)
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
    angles_deg = (-50, -30, -10, 10, 30, 50)
    # A short mean of the unit vectors towards the cameras: they surround the scene.
    if np.linalg.norm(towards) < 0.6:
        # The cameras' mean position is within the scene: start at one of them.
        towards, angles_deg = offsets[0], (0, 60, 120, 180, 240, 300)
    start = towards / np.linalg.norm(towards) * 1.15 * float(np.median(distance))
    up = up_direction([view.rotation for view in views])
    return [middle + cv2.Rodrigues(up * np.radians(angle_deg))[0] @ start for angle_deg in angles_deg], up


def _drop_outliers(o3d: Any, fused: FusedCloud) -> Any:
    """Return Open3D's cloud of the points that are not far from their neighbours."""
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(fused.points))
    cloud.normals = o3d.utility.Vector3dVector(fused.normals)
    cloud.colors = o3d.utility.Vector3dVector(fused.colours / 255)
    # A point is judged by sixteen neighbours.
    neighbours = 16
    enough = len(fused.points) > neighbours
    return cloud.remove_statistical_outlier(neighbours, 2.5)[0] if enough else cloud


def up_direction(rotations: Sequence[Array]) -> Array:
    """Return the up direction (3,) of most images in the rig's frame, from `cam_from_rig` rotations.

    It is along the principal axis of the images' columns, which upside-down cameras share.
    """
    down = np.array([rotation[1] for rotation in rotations])
    axis = np.linalg.eigh(down.T @ down)[1][:, -1]
    return np.asarray(axis if np.sum(np.sign(down @ axis)) < 0 else -axis)
