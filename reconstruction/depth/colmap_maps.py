"""COLMAP's files of depth and normals: `width&height&channels&`, then float32 row by row, channel by channel.

Written here because pycolmap 4.2's `NormalMap.from_array` takes the channels for the innermost axis, and
COLMAP's own code then reads wrong normals; fusion silently drops most points.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from capture_app.errors import SimulshotError
from reconstruction.common.geometry import Array
from reconstruction.depth.sweep_matcher import ViewDepth


def write_maps(workspace: Path, file: str, found: ViewDepth) -> None:
    """Write one picture's depth and normals, as COLMAP's geometric pass would."""
    write_array(workspace / "stereo" / "depth_maps" / f"{file}.geometric.bin", found.depth)
    write_array(workspace / "stereo" / "normal_maps" / f"{file}.geometric.bin", found.normals)


def read_maps(workspace: Path, names: Mapping[str, str]) -> dict[str, ViewDepth]:
    """Depth and normals that PatchMatch left in the workspace, by camera; `names` are the picture files.

    Raises:
        SimulshotError: a map is missing or broken.
    """
    found = {}
    for camera, file in names.items():
        depth = read_array(workspace / "stereo" / "depth_maps" / f"{file}.geometric.bin")
        normal = read_array(workspace / "stereo" / "normal_maps" / f"{file}.geometric.bin")
        found[camera] = ViewDepth(np.maximum(depth, 0), normal * (depth > 0)[..., None])
    return found


def read_array(path: Path) -> Array:
    """A map, float32 height x width (x channels).

    Raises:
        SimulshotError: it is missing or truncated.
    """
    try:
        data = path.read_bytes()
        width, height, channels = (int(part) for part in data.split(b"&", 3)[:3])
        start = len(b"&".join(data.split(b"&", 3)[:3])) + 1
        values = np.frombuffer(data, np.float32, offset=start)
        shaped = values.reshape(channels, height, width).transpose(1, 2, 0)
    except (OSError, ValueError) as error:
        raise SimulshotError(f"{path} is not a depth or normal map of COLMAP: {error}") from error
    return np.array(shaped[..., 0] if channels == 1 else shaped)


def write_array(path: Path, values: Array) -> None:
    """Write a map of height x width (x channels)."""
    channels = values.shape[2] if values.ndim == 3 else 1
    header = f"{values.shape[1]}&{values.shape[0]}&{channels}&".encode()
    planes = np.moveaxis(values.reshape(*values.shape[:2], channels), 2, 0)
    path.write_bytes(header + np.ascontiguousarray(planes, "<f4").tobytes())
