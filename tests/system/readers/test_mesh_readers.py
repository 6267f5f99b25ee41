"""mesh.glb, read by pygltflib: the mesh of mesh.ply, where cameras.gltf has its cameras and points."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from capture_app.plugins.programs.splats.gltf_cameras import write_gltf
from capture_app.session.exporting.point_cloud import read_ply
from reconstruction.common.geometry import Array
from reconstruction.methods.multiview.fusion import FusedCloud
from reconstruction.methods.multiview.mesh import build_mesh
from reconstruction.methods.multiview.sweep_matcher import ViewDepth
from tests.unit.reconstruction.conftest import make_view

DEPTH_CM = 200.0
SKY_RGB, GROUND_RGB = (40, 120, 220), (128, 60, 5)
LINEAR_128 = 0.2159
"""Linear light of sRGB's grey level 128."""
LEVELS = {5125: "<u4", 5126: "<f4", 5121: "u1", 5123: "<u2"}
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}


def values(content: Any, number: int) -> Array:
    """An accessor's values (n, width), floats between 0 and 1 where it says that they are normalized."""
    accessor = content.accessors[number]
    view = content.bufferViews[accessor.bufferView]
    data = content.get_data_from_buffer_uri(content.buffers[0].uri) if content.buffers[0].uri else None
    data = content.binary_blob() if data is None else data
    begin = (view.byteOffset or 0) + (accessor.byteOffset or 0)
    kind, width = np.dtype(LEVELS[accessor.componentType]), WIDTHS[accessor.type]
    assert begin % kind.itemsize == 0
    read = np.frombuffer(data, kind, accessor.count * width, begin).reshape(-1, width)
    return read / np.iinfo(kind).max if accessor.normalized else read


def placed(content: Any) -> tuple[Array, Array]:
    """The positions (n, 3) of the only mesh in the file's own axes, and its colours (n, 3), linear light."""
    place = np.eye(4)
    number = content.scenes[0].nodes[0]
    while True:
        node = content.nodes[number]
        place = place @ np.reshape(node.matrix or np.eye(4), (4, 4)).T
        if node.mesh is not None:
            break
        number = next(k for k in node.children if content.nodes[k].camera is None)
    attributes = content.meshes[0].primitives[0].attributes
    points = values(content, attributes.POSITION)
    return points @ place[:3, :3].T + place[:3, 3], values(content, attributes.COLOR_0)[:, :3]


def test_a_gltf_library_has_the_mesh(tmp_path: Path) -> None:
    """A wall, blue above and brown below, in centimetres, before a camera that is turned."""
    pygltflib = pytest.importorskip("pygltflib", reason="pygltflib is not installed")
    view = make_view((10.0, 0, 0), yaw=20)
    depth = np.full((240, 320), DEPTH_CM, np.float32)
    depth[100:, 150:170] = 0
    picture = np.full((240, 320, 3), SKY_RGB[::-1], np.uint8)
    picture[120:] = GROUND_RGB[::-1]
    facing = np.tile(np.array([0, 0, -1], np.float32), (240, 320, 1))
    cloud = np.array([[0, 0, DEPTH_CM]], np.float32)
    fused = FusedCloud(cloud, -cloud / DEPTH_CM, np.full((1, 3), 99, np.uint8), np.ones((1, 1), bool))
    maps = {"cam": ViewDepth(depth, facing)}
    _, triangles, files = build_mesh(fused, tmp_path, {"cam": view}, maps, {"cam": picture}, unit="cm")
    assert "mesh.glb" in files
    ply = read_ply(tmp_path / "mesh.ply")
    write_gltf(tmp_path / "cameras.gltf", {"cam": view.to_calibration()}, ply, "cm")
    mesh = pygltflib.GLTF2().load(str(tmp_path / "mesh.glb"))
    cameras = pygltflib.GLTF2().load(str(tmp_path / "cameras.gltf"))
    points, colours = placed(mesh)
    indices = values(mesh, mesh.meshes[0].primitives[0].indices)
    assert len(points) == len(ply.points) > 70_000
    assert len(indices) == 3 * triangles
    assert indices.max() == len(points) - 1
    # In metres, upright, and before the camera, which looks along -z.
    sky = colours[:, 2] > colours[:, 0]
    assert points[sky, 1].min() > points[~sky, 1].max() - 1e-6
    assert points[:, 2].max() < -1
    theirs, painted = placed(cameras)
    assert points == pytest.approx(theirs, abs=1e-5)
    assert colours == pytest.approx(painted, abs=1e-4)
    assert colours[~sky][0, 0] == pytest.approx(LINEAR_128, abs=1e-4)
    # Triangles face the camera; the material is no metal, which browsers would draw black.
    a, b, c = points[indices.reshape(-1, 3)].transpose(1, 0, 2)
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()
    assert mesh.materials[mesh.meshes[0].primitives[0].material].pbrMetallicRoughness.metallicFactor == 0
