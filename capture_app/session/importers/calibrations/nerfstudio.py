"""nerfstudio's `transforms.json`: a pose for every image, in OpenGL's camera axes.

By docs.nerf.studio ("Nerfstudio dataset format") and nerfstudio/data/dataparsers/nerfstudio_dataparser.py:
fl_x, fl_y, cx, cy, w, h and the distortion k1, k2, k3, p1, p2 stand in each frame or once for all;
`transform_matrix` is the camera's place in the world, x right, y up, z backwards; the first pixel's centre
is (0.5, 0.5). Older files give camera_angle_x, the horizontal field of view in radians, instead of fl_x.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from capture_app.errors import BadInputError
from capture_app.session.importers.calibrations.camera_views import View, Views
from capture_app.session.importers.calibrations.image_poses import camera_of, views_of_images

_HALF_PIXEL = 0.5
_PERSPECTIVE = ("OPENCV", "PINHOLE", "PERSPECTIVE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
_OPENCV_FROM_OPENGL = np.array([1.0, -1.0, -1.0])


def views_of_transforms(path: Path, content: Mapping[str, Any], cameras: Sequence[str]) -> Views:
    """The cameras of a decoded transforms.json; an image is of the camera that its path names.

    The unit is arbitrary unless the file has `unit`, as our own exports do. Raises BadInputError, with the
    image, for what is missing, for fisheye lenses and for cameras that move.
    """
    frames = content.get("frames")
    if not isinstance(frames, list) or not frames:
        raise BadInputError(f"{path} has no frames", hint="is it nerfstudio's transforms.json?")
    images = [_image(path, content, frame, cameras) for frame in frames]
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
        raise BadInputError(f"{path} has a frame without a file_path")
    file, all_of = frame["file_path"], {**content, **frame}
    where = f"{path}: {file}"
    model = str(all_of.get("camera_model", "OPENCV")).upper()
    if model not in _PERSPECTIVE or all_of.get("is_fisheye"):
        raise BadInputError(f"{where} is of a {model} camera; only perspective ones are supported")
    if _number(where, all_of, "k4", 0.0):
        raise BadInputError(f"{where} has a distortion k4; k1, k2, p1, p2, k3 are supported")
    name = frame.get("camera")
    label = name if isinstance(name, str) else camera_of(file, cameras)
    pose = np.asarray(_numbers(where, all_of.get("transform_matrix"), "transform_matrix"), np.float64)
    if pose.shape not in ((4, 4), (3, 4)):
        raise BadInputError(f"{where}: transform_matrix is not 4x4")
    rotation = (pose[:3, :3] * _OPENCV_FROM_OPENGL).T
    width, height = (round(_number(where, all_of, key)) for key in ("w", "h"))
    fx = _number(where, all_of, "fl_x", _focal_length(where, all_of, "camera_angle_x", width))
    fy = _number(where, all_of, "fl_y", _focal_length(where, all_of, "camera_angle_y", height) or fx)
    cx = _number(where, all_of, "cx", width / 2) - _HALF_PIXEL
    cy = _number(where, all_of, "cy", height / 2) - _HALF_PIXEL
    view = View(
        matrix=np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]),
        distortion=np.array([_number(where, all_of, key, 0.0) for key in ("k1", "k2", "p1", "p2", "k3")]),
        rotation=rotation,
        translation=-rotation @ pose[:3, 3],
        size=(width, height),
    )
    return label, view


def _focal_length(where: str, given: Mapping[str, Any], key: str, pixels: int) -> float | None:
    if key not in given:
        return None
    return pixels / 2 / math.tan(_number(where, given, key) / 2)


def _number(where: str, given: Mapping[str, Any], key: str, otherwise: float | None = None) -> float:
    value = given.get(key, otherwise)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise BadInputError(f"{where} has no number {key}")
    return float(value)


def _numbers(where: str, value: Any, key: str) -> Any:
    try:
        return np.asarray(value, np.float64)
    except (TypeError, ValueError):
        raise BadInputError(f"{where}: {key} is not made of numbers") from None
