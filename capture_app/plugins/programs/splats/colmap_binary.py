"""COLMAP's binary sparse model with pinhole cameras, as Gaussian-splatting trainers read it."""

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from capture_app.session.exporting.point_cloud import PointCloud
from capture_app.session.exporting.starting_points import visible_pixels
from capture_app.session.format.calibration import CameraCalibration
from capture_app.session.format.lens import quaternion, rotation_of

_HALF_PIXEL = 0.5  # COLMAP's first pixel has its centre at (0.5, 0.5)
_PINHOLE = 1  # model_id of PINHOLE: fx, fy, cx, cy


def write_model(
    folder: Path,
    cameras: Mapping[str, CameraCalibration],
    images: Sequence[tuple[str, str]],
    cloud: PointCloud,
) -> None:
    """Write cameras.bin, images.bin and points3D.bin; `images` are pairs of camera and file name.

    Cameras are pinholes, numbered from 1 in their order. Every point that two cameras see has a track.
    """
    folder.mkdir(parents=True, exist_ok=True)
    numbers = {name: number for number, name in enumerate(cameras, 1)}
    lines = [struct.pack("<Q", len(cameras))]
    for name, lens in cameras.items():
        centre = lens.cx + _HALF_PIXEL, lens.cy + _HALF_PIXEL
        size = lens.width, lens.height
        lines.append(struct.pack("<IiQQ4d", numbers[name], _PINHOLE, *size, lens.fx, lens.fy, *centre))
    (folder / "cameras.bin").write_bytes(b"".join(lines))

    pixels = {name: visible_pixels(lens, cloud.points) + _HALF_PIXEL for name, lens in cameras.items()}
    tracked = np.sum([np.isfinite(seen[:, 0]) for seen in pixels.values()], axis=0) >= 2
    own = {name: np.flatnonzero(tracked & np.isfinite(seen[:, 0])) for name, seen in pixels.items()}
    lines, tracks = [struct.pack("<Q", len(images))], [b""] * len(cloud.points)
    for number, (name, file) in enumerate(images, 1):
        lens, points = cameras[name], own[name]
        pose = *quaternion(rotation_of(lens)), *lens.translation
        observed = np.zeros(len(points), [("pixel", "<f8", 2), ("point", "<u8")])
        observed["pixel"], observed["point"] = pixels[name][points], points + 1
        head = struct.pack("<I7dI", number, *pose, numbers[name]) + file.encode() + b"\0"
        lines.append(head + struct.pack("<Q", len(points)) + observed.tobytes())
        for order, point in enumerate(points):
            tracks[point] += struct.pack("<II", number, order)
    (folder / "images.bin").write_bytes(b"".join(lines))

    lines = [struct.pack("<Q", len(cloud.points))]
    for number, (point, colour) in enumerate(zip(cloud.points, cloud.colours, strict=True), 1):
        track = tracks[number - 1]
        lines.append(struct.pack("<Q3d3BdQ", number, *point, *colour, 0.0, len(track) // 8) + track)
    (folder / "points3D.bin").write_bytes(b"".join(lines))
