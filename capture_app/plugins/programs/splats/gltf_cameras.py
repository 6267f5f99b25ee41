"""Cameras and points as glTF 2.0, which Blender, Unreal and browsers open."""

import base64
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from capture_app.common.srgb import to_linear
from capture_app.session.exporting.pinhole import opengl_pose
from capture_app.session.exporting.point_cloud import PointCloud
from capture_app.session.format.calibration import METRES, CameraCalibration

_UPRIGHT = [1, 0, 0, 0, 0, -1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1]
"""glTF's y points up, the rig's down."""
_FLOAT, _SHORT, _POINTS, _VERTICES = 5126, 5123, 0, 34962


def write_gltf(path: Path, cameras: Mapping[str, CameraCalibration], cloud: PointCloud, unit: str) -> None:
    """Write a file with a node of each camera and the points, in metres if `unit` is a length.

    A glTF camera has no principal point: it is taken as the image's centre.
    """
    metres = METRES.get(unit, 1.0)
    nodes: list[dict[str, Any]] = [{"name": "rig", "matrix": _UPRIGHT}]
    lenses = []
    for number, (name, lens) in enumerate(cameras.items()):
        perspective = {
            "aspectRatio": lens.width * lens.fy / (lens.height * lens.fx),
            "yfov": 2 * math.atan(lens.height / (2 * lens.fy)),
            "znear": 0.01,
        }
        lenses.append({"name": name, "type": "perspective", "perspective": perspective})
        pose = opengl_pose(lens)
        pose[:3, 3] *= metres
        nodes.append({"name": name, "camera": number, "matrix": pose.T.ravel().tolist()})
    places = (cloud.points * metres).astype("<f4")
    # glTF's colours are linear light; 8 bits of it would show steps in the dark.
    linear = np.column_stack([to_linear(cloud.colours), np.ones(len(places))])
    colours = np.rint(65535 * linear).astype("<u2")
    data = places.tobytes() + colours.tobytes()
    views = [
        {"buffer": 0, "byteOffset": 0, "byteLength": places.nbytes, "target": _VERTICES},
        {"buffer": 0, "byteOffset": places.nbytes, "byteLength": colours.nbytes, "target": _VERTICES},
    ]
    ends = {"min": places.min(axis=0).tolist(), "max": places.max(axis=0).tolist()}
    accessors = [
        {"bufferView": 0, "componentType": _FLOAT, "count": len(places), "type": "VEC3", **ends},
        {"bufferView": 1, "componentType": _SHORT, "normalized": True, "count": len(places), "type": "VEC4"},
    ]
    nodes.append({"name": "points", "mesh": 0})
    nodes[0]["children"] = list(range(1, len(nodes)))
    content = {
        "asset": {"version": "2.0", "generator": "simulshot"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": nodes,
        "cameras": lenses,
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "COLOR_0": 1}, "mode": _POINTS}]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [
            {
                "byteLength": len(data),
                "uri": f"data:application/octet-stream;base64,{base64.b64encode(data).decode()}",
            }
        ],
    }
    path.write_text(json.dumps(content), encoding="utf-8")
