"""Cameras and points as glTF 2.0, which Blender, Unreal and browsers open."""

import math
from collections.abc import Mapping
from pathlib import Path

from capture_app.common.gltf import Gltf
from capture_app.session.exporting.pinhole import opengl_pose
from capture_app.session.exporting.point_cloud import PointCloud
from capture_app.session.format.calibration import METRES, CameraCalibration

_UPRIGHT = [1, 0, 0, 0, 0, -1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1]
"""glTF's y points up, the rig's down."""
_POINTS = 0
"""glTF's mode of drawing points."""


def write_gltf(path: Path, cameras: Mapping[str, CameraCalibration], cloud: PointCloud, unit: str) -> None:
    """Write a file with a node of each camera and the points, in metres if `unit` is a length.

    A glTF camera has no principal point: it is taken as the image's centre.
    """
    metres = METRES.get(unit, 1.0)
    document = Gltf()
    parts = [*range(1, len(cameras) + 2)]
    document.add("scenes", nodes=[document.add("nodes", name="rig", matrix=_UPRIGHT, children=parts)])
    for name, lens in cameras.items():
        perspective = {
            "aspectRatio": lens.width * lens.fy / (lens.height * lens.fx),
            "yfov": 2 * math.atan(lens.height / (2 * lens.fy)),
            "znear": 0.01,
        }
        camera = document.add("cameras", name=name, type="perspective", perspective=perspective)
        pose = opengl_pose(lens)
        pose[:3, 3] *= metres
        document.add("nodes", name=name, camera=camera, matrix=pose.T.ravel().tolist())
    points = {
        "POSITION": document.add_array("<f4", cloud.points * metres),
        "COLOR_0": document.add_colours(cloud.colours),
    }
    mesh = document.add("meshes", primitives=[{"attributes": points, "mode": _POINTS}])
    document.add("nodes", name="points", mesh=mesh)
    path.write_bytes(document.encode())
