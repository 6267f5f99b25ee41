"""nerfstudio's transforms.json as a calibration: a pose for every image, in OpenGL's camera axes.

Sources: docs.nerf.studio ("Nerfstudio dataset format") and
nerfstudio/data/dataparsers/nerfstudio_dataparser.py. fl_x, fl_y, cx, cy, w, h and the distortion k1, k2, k3,
p1, p2 are given for each frame or once for all. `transform_matrix` is the camera's pose in the world: x
right, y up, z backwards. The first pixel's centre is (0.5, 0.5). Older files give camera_angle_x, the
horizontal field of view in radians, instead of fl_x.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.session.importing.importer import Importer
from capture_app.session.importing.views import (
    EXPORT_AGAIN,
    View,
    Views,
    camera_of,
    numbers,
    pinhole,
    read_json,
    views_of_images,
)

_TRANSFORMS = "transforms.json"
_HALF_PIXEL = 0.5
_PERSPECTIVE = ("OPENCV", "PINHOLE", "PERSPECTIVE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
_OPENCV_FROM_OPENGL = np.array([1.0, -1.0, -1.0])


def read_calibration(paths: Sequence[tuple[str, Path]], cameras: Sequence[str]) -> Views | None:
    """Read the cameras of a transforms.json or of its folder; an image's path names its camera.

    The unit is arbitrary unless the file has `unit`, as our own exports do. Raises BadInputError, with the
    image, for missing values, fisheye lenses and cameras that move.
    """
    path = paths[0][1]
    path = path / _TRANSFORMS if (path / _TRANSFORMS).is_file() else path
    content = read_json(path)
    if not isinstance(content, dict) or not isinstance(content.get("frames"), list):
        return None
    if not content["frames"]:
        raise BadInputError(f"{path} has no frames", hint="give one whose list frames has each camera")
    images = [_image(path, content, frame, cameras) for frame in content["frames"]]
    hint = "a rig stands still: give the file of one instant, with one image a camera"
    unit = content.get("unit")
    return Views(
        views_of_images(str(path), images, hint),
        path.name,
        unit if isinstance(unit, str) else None,
        assumed_unit="arbitrary",
    )


def _image(path: Path, content: Mapping[str, Any], frame: Any, cameras: Sequence[str]) -> tuple[str, View]:
    if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str):
        raise BadInputError(f"{path} has a frame without a file_path", hint=EXPORT_AGAIN)
    file, all_of = frame["file_path"], {**content, **frame}
    where = f"{path}: {file}"
    model = str(all_of.get("camera_model", "OPENCV")).upper()
    if model not in _PERSPECTIVE or all_of.get("is_fisheye"):
        raise BadInputError(
            f"{where} is of a {model} camera; only perspective ones are supported",
            hint="undistort the images to a perspective camera and calibrate again",
        )
    if _number(where, all_of, "k4", 0.0):
        raise BadInputError(
            f"{where} has a distortion k4; k1, k2, p1, p2, k3 are supported",
            hint="calibrate with k1, k2, p1, p2, k3",
        )
    name = frame.get("camera")
    label = name if isinstance(name, str) else camera_of(file, cameras)
    pose = numbers(where, all_of, "transform_matrix", 12, 16).reshape(-1, 4)
    rotation = (pose[:3, :3] * _OPENCV_FROM_OPENGL).T
    width, height = (round(_number(where, all_of, key)) for key in ("w", "h"))
    fx = _number(where, all_of, "fl_x", _focal_length(where, all_of, "camera_angle_x", width))
    fy = _number(where, all_of, "fl_y", _focal_length(where, all_of, "camera_angle_y", height) or fx)
    cx, cy = (_number(where, all_of, key, side / 2) for key, side in (("cx", width), ("cy", height)))
    view = View(
        matrix=pinhole(fx, fy, cx - _HALF_PIXEL, cy - _HALF_PIXEL),
        distortion=np.array([_number(where, all_of, key, 0.0) for key in ("k1", "k2", "p1", "p2", "k3")]),
        rotation=rotation,
        translation=-rotation @ pose[:3, 3],
        size=(width, height),
    )
    return label, view


def _focal_length(where: str, given: Mapping[str, Any], key: str, pixels: int) -> float | None:
    if key not in given:
        return None
    angle = _number(where, given, key)
    if not 0 < angle < math.pi:
        raise BadInputError(f"{where} has the {key} {angle:g}", hint="it is in radians, between 0 and pi")
    return pixels / 2 / math.tan(angle / 2)


def _number(where: str, given: Mapping[str, Any], key: str, otherwise: float | None = None) -> float:
    value = given.get(key, otherwise)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise BadInputError(f"{where} has no number {key}", hint=EXPORT_AGAIN)
    return float(value)


IMPORTER = Importer(
    program="nerfstudio",
    help="transforms.json, or its folder, as a calibration",
    read_calibration=read_calibration,
    calibration_files=(_TRANSFORMS,),
)
