"""The mesh of true maps: whole surfaces, each once, and no triangle across an edge of depth."""

import json
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from capture_app.session.exporting.point_cloud import read_ply
from reconstruction.common.geometry import Array, View, resize_view
from reconstruction.methods.multiview import mesh
from reconstruction.methods.multiview.fusion import FusedCloud
from reconstruction.methods.multiview.mesh import build_mesh, join_maps
from reconstruction.methods.multiview.sweep_matcher import ViewDepth
from tests.unit.reconstruction.conftest import Scene, make_view

VIEWS = {name: make_view((x, 0.02, 0), yaw=-5 * x) for name, x in (("left", -0.2), ("right", 0.2))}


def true_map(scene: Scene, view: View) -> ViewDepth:
    """What a camera sees of the boards, which all face the rig's origin."""
    depth = scene.look(view, 2.0)[1]
    return ViewDepth(depth, np.broadcast_to(-view.rotation[:, 2], (*depth.shape, 3)).astype(np.float32))


def true_mesh(scene: Scene, views: dict[str, View] = VIEWS) -> tuple[Array, Array, Array]:
    maps = {name: true_map(scene, view) for name, view in views.items()}
    painted = [
        np.full((*found.depth.shape, 3), (10 * k, 100, 200), np.uint8)
        for k, found in enumerate(maps.values())
    ]
    return join_maps(views, maps, dict(zip(maps, painted, strict=True)))


def test_a_binary_gltf_holds_the_mesh(tmp_path: Path) -> None:
    corners = np.array([[0, 0, -1.0], [1, 0, -1], [0, 2, -1], [1, 2, -3]])
    colours = np.array([[0, 128, 255]] * 4, np.uint8)
    triangles = np.array([[0, 1, 2], [2, 1, 3]])
    mesh.write_glb(tmp_path / "mesh.glb", corners, colours, triangles)
    data = (tmp_path / "mesh.glb").read_bytes()
    magic, version, size, length, kind = struct.unpack_from("<4sIII4s", data)
    assert (magic, version, size, kind) == (b"glTF", 2, len(data), b"JSON")
    document = json.loads(data[20 : 20 + length])
    assert struct.unpack_from("<I4s", data, 20 + length) == (document["buffers"][0]["byteLength"], b"BIN\0")
    parts = [
        np.frombuffer(
            data, kind, part["byteLength"] // np.dtype(kind).itemsize, 28 + length + part["byteOffset"]
        )
        for part, kind in zip(document["bufferViews"], ("<f4", "<u2", "<u4"), strict=True)
    ]
    assert parts[0].reshape(-1, 3).tolist() == corners.tolist()
    assert parts[1].reshape(-1, 4)[3] / 65535 == pytest.approx([0, 0.2159, 1, 1], abs=1e-4)
    assert parts[2].tolist() == triangles.ravel().tolist()
    assert [part["count"] for part in document["accessors"]] == [4, 4, 6]
    assert document["accessors"][0]["max"] == [1, 2, -1]


def corner_areas(points: Array, triangles: Array) -> Array:
    a, b, c = points[triangles].transpose(1, 0, 2)
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2)


def test_no_triangle_joins_two_boards_and_all_boards_are_whole(scene: Scene) -> None:
    points, _, triangles = true_mesh(scene)
    boards = np.array([board.z for board in scene.boards])
    of = np.abs(points[:, 2:] - boards).argmin(1)
    assert np.abs(points[:, 2] - boards[of]).max() < 0.002
    assert (of[triangles] == of[triangles][:, :1]).all()
    mover = corner_areas(points, triangles[of[triangles[:, 0]] == len(boards) - 1]).sum()
    # Less a rim of half a pixel, and with the seam of the second map.
    assert mover == pytest.approx(0.36, rel=0.06)


def test_a_single_map_is_the_mesh(scene: Scene) -> None:
    left = {"left": VIEWS["left"]}
    points, _, triangles = true_mesh(scene, left)
    depth = true_map(scene, VIEWS["left"]).depth
    assert len(points) == np.count_nonzero(depth)
    assert len(triangles) > len(points)
    assert points == pytest.approx(VIEWS["left"].unproject(VIEWS["left"].grid(), depth.reshape(-1)))


def test_what_two_maps_see_is_taken_from_the_first(scene: Scene) -> None:
    points, colours, triangles = true_mesh(scene)
    second = colours[:, 2] == 10
    pixels = 320 * 240
    assert 0.95 * pixels < (~second).sum() <= pixels
    assert 0.1 * pixels < second.sum() < 0.35 * pixels
    assert (colours[:, :2] == (200, 100)).all()
    # All triangles face the cameras, and none is larger than a pixel on the wall.
    a, b, c = points[triangles].transpose(1, 0, 2)
    assert (np.cross(b - a, c - a)[:, 2] < 0).all()
    assert corner_areas(points, triangles).max() < (4.2 / 300) ** 2


def test_points_are_the_mean_of_the_maps_without_what_others_deny() -> None:
    views = {f"cam{k}": make_view((0.05 * k, 0, 0)) for k in range(3)}
    shape = (240, 320)
    facing = np.tile(np.array([0, 0, -1], np.float32), (*shape, 1))
    maps = {
        name: ViewDepth(np.full(shape, z, np.float32), facing)
        for name, z in zip(views, (2, 2.01, 2.005), strict=True)
    }
    maps["cam0"].depth[100:140, 100:140] = 1.5
    picture = np.zeros((*shape, 3), np.uint8)
    points, _, _ = join_maps(views, maps, dict.fromkeys(views, picture))
    assert points[:, 2].min() > 1.99
    # All three see the middle.
    middle = points[np.abs(points[:, 0]) < 0.3]
    assert np.median(middle[:, 2]) == pytest.approx(2.005, abs=1e-4)


def test_what_one_map_has_a_percent_nearer_is_not_torn_away() -> None:
    views = {f"cam{k}": make_view((0.05 * k, 0, 0)) for k in range(3)}
    shape = (240, 320)
    facing = np.tile(np.array([0, 0, -1], np.float32), (*shape, 1))
    maps = {
        name: ViewDepth(np.full(shape, z, np.float32), facing)
        for name, z in zip(views, (2, 1.974, 2), strict=True)
    }
    picture = np.zeros((*shape, 3), np.uint8)
    points, _, triangles = join_maps(views, maps, dict.fromkeys(views, picture))
    middle = np.abs(points[:, 0]) < 0.3
    assert middle[triangles].all(1).sum() > 0.9 * 0.6 * 2 * 240 * (300 / 2)
    assert np.abs(points[middle, 2] - 2).max() < 1e-3


def wall_map(view: View, normal: Array, distance: float) -> ViewDepth:
    """The true depth of an endless wall."""
    rays = view.rays(view.grid())
    depth = (distance - view.centre @ normal) / (rays @ view.rotation @ normal)
    there = np.where((depth > 0) & (depth < 20), depth, 0).reshape(240, 320).astype(np.float32)
    return ViewDepth(there, np.broadcast_to(-view.rotation @ normal, (240, 320, 3)).astype(np.float32))


def test_a_wall_at_a_grazing_angle_is_whole() -> None:
    """From pixel to pixel, its depth changes by up to 10 %."""
    views = {name: make_view((0, y, 0)) for name, y in (("cam0", 0.0), ("cam1", 0.02))}
    maps = {name: wall_map(view, np.array([1.0, 0, 0]), 0.5) for name, view in views.items()}
    seen = int((maps["cam0"].depth > 0).sum())
    picture = {name: np.zeros((240, 320, 3), np.uint8) for name in views}
    points, _, triangles = join_maps(views, maps, picture)
    assert len(points) > 0.95 * seen
    assert len(triangles) > 1.9 * seen


def test_what_the_first_map_tears_is_taken_from_the_next() -> None:
    views = {name: make_view((x, 0, 0)) for name, x in (("cam0", 0.0), ("cam1", 0.1))}
    maps = {name: wall_map(view, np.array([0, 0, 1.0]), 2.0) for name, view in views.items()}
    # Every second pixel of some rows is so far behind the others that no triangle joins them.
    maps["cam0"].depth[100:140, ::2] *= 1.012
    picture = {name: np.zeros((240, 320, 3), np.uint8) for name in views}
    points, _, triangles = join_maps(views, maps, picture)
    low, high = (
        views["cam0"].unproject(np.array([[160.0, row]]), np.array([2.0]))[0, 1] for row in (104, 136)
    )
    x, y, _ = points[triangles].mean(1).T
    inside = (np.abs(x) < 0.5) & (y > low) & (y < high)
    assert corner_areas(points, triangles[inside]).sum() == pytest.approx(high - low, rel=0.1)


def test_wide_maps_give_fewer_triangles_of_the_same_place(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    fine, _, many = true_mesh(scene)
    monkeypatch.setattr(mesh, "MAX_WIDTH_PX", 160)
    coarse, _, few = true_mesh(scene)
    assert len(few) == pytest.approx(len(many) / 4, rel=0.1)
    assert coarse.mean(0) == pytest.approx(fine.mean(0), abs=0.05)
    assert np.ptp(coarse, axis=0) == pytest.approx(np.ptp(fine, axis=0), abs=0.05)


def test_maps_without_depth_give_no_mesh() -> None:
    nothing = ViewDepth(np.zeros((240, 320), np.float32), np.zeros((240, 320, 3), np.float32))
    picture = np.zeros((240, 320, 3), np.uint8)
    points, _, triangles = join_maps(VIEWS, dict.fromkeys(VIEWS, nothing), dict.fromkeys(VIEWS, picture))
    assert len(points) == len(triangles) == 0


@pytest.mark.parametrize("unit", ["m", "mm"])
def test_files_of_a_mesh_are_cleaned_upright_and_in_metres(tmp_path: Path, scene: Scene, unit: str) -> None:
    pytest.importorskip("open3d", reason="open3d has no package for this machine")
    small = {name: resize_view(view, 80, 60) for name, view in VIEWS.items()}
    maps = {name: true_map(scene, view) for name, view in small.items()}
    pictures = {name: np.full((60, 80, 3), (10, 100, 200), np.uint8) for name in small}
    points, _, triangles = join_maps(small, maps, pictures)
    away = np.append(points, [[30, 0, 5.0]], axis=0).astype(np.float32)
    facing = np.tile(np.array([0, 0, -1], np.float32), (len(away), 1))
    cloud = FusedCloud(away, facing, np.tile(np.array([200, 100, 10], np.uint8), (len(away), 1)), away > 0)
    count, faces, files = build_mesh(cloud, tmp_path, small, maps, pictures, unit=unit)
    assert files == ("cloud.ply", "mesh.ply", "mesh.glb", "turntable.png")
    assert {path.name for path in tmp_path.iterdir()} == {*files}
    assert faces == len(triangles) > 5000
    left = read_ply(tmp_path / "cloud.ply")
    assert len(left.points) == count
    assert 0.9 * len(points) < count <= len(points)
    assert left.points[:, 0].max() < 10
    assert (left.colours == (200, 100, 10)).all()
    assert b"property double nx" in (tmp_path / "cloud.ply").read_bytes()[:400]
    assert b"property uchar red" in (tmp_path / "mesh.ply").read_bytes()[:400]
    document = json.JSONDecoder().raw_decode((tmp_path / "mesh.glb").read_bytes()[20:].decode("latin-1"))[0]
    metres = 1.0 if unit == "m" else 0.001
    assert document["accessors"][0]["max"][2] == pytest.approx(-points[:, 2].min() * metres, rel=1e-4)
    assert document["accessors"][0]["max"][1] == pytest.approx(-points[:, 1].min() * metres, rel=1e-4)
    assert np.asarray(cv2.imread(str(tmp_path / "turntable.png"))).std() > 5
    assert build_mesh(cloud, tmp_path, small, maps, pictures, unit=unit, mesh=False) == (
        count,
        0,
        ("cloud.ply",),
    )
    few = FusedCloud(*(part[-5:] for part in (away, facing, cloud.colours, cloud.seen)))
    assert build_mesh(few, tmp_path, small, maps, pictures, unit=unit, mesh=False)[0] == 5


def test_what_is_behind_the_place_it_is_drawn_from_is_not_drawn() -> None:
    """A point ahead is a square of three pixels, the nearest of several."""
    eye, middle, up = np.zeros(3), np.array([0.0, 0, 2]), np.array([0.0, -1, 0])
    colours = np.array([[10, 20, 30], [40, 50, 60], [70, 80, 90]], np.uint8)
    points = np.array([[0, 0, 2.0], [0, 0, 1.0], [0, 0, -1.0]])
    picture = mesh._draw_points(points, colours, eye, middle, up)
    height, width, _ = picture.shape
    drawn = (picture != picture[0, 0]).any(2)
    assert drawn.sum() == 9
    assert picture[height // 2, width // 2].tolist() == [60, 50, 40]
    assert not (mesh._draw_points(points[2:], colours[2:], eye, middle, up) != picture[0, 0]).any()


def test_a_folder_that_cannot_be_written_to_is_said(tmp_path: Path) -> None:
    pytest.importorskip("open3d", reason="open3d has no package for this machine")
    points = np.random.default_rng(1).normal(size=(9, 3)).astype(np.float32)
    cloud = FusedCloud(points, points, np.zeros((9, 3), np.uint8), points > 0)
    gone = tmp_path / "gone"
    with pytest.raises(OSError, match="cannot write the cloud and the mesh into"):
        build_mesh(cloud, gone, {}, {}, {}, unit="m", mesh=False)
