"""Calibrations of other programs, told apart by what is in them, and converted to this project's convention.

nerfstudio's `transforms.json` gives a pose for every image, in OpenGL's camera axes. By docs.nerf.studio
("Nerfstudio dataset format") and nerfstudio/data/dataparsers/nerfstudio_dataparser.py: fl_x, fl_y, cx, cy, w,
h and the distortion k1, k2, k3, p1, p2 stand in each frame or once for all; `transform_matrix` is the
camera's place in the world, x right, y up, z backwards; the first pixel's centre is (0.5, 0.5). Older files
give camera_angle_x, the horizontal field of view in radians, instead of fl_x.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.session.files.strangers import read_struct
from capture_app.session.format.calibration import (
    METRES,
    Calibration,
    CameraCalibration,
    Matrix3,
    check_lens,
)
from capture_app.session.format.manifest import CALIBRATION
from capture_app.session.importers.calibrations.colmap import find_model, read_colmap, views_of_rig_config
from capture_app.session.importers.calibrations.motion_capture import (
    is_easymocap,
    is_opencap,
    read_caliscope,
    read_easymocap,
    read_opencap,
    read_qualisys,
)
from capture_app.session.importers.calibrations.opencv import read_opencv
from capture_app.session.importers.calibrations.views import (
    Array,
    View,
    Views,
    camera_of,
    numbers,
    pinhole,
    views_of_images,
)
from capture_app.session.importers.rate_or_table import match_name

Fit = Literal["exact", "crop", "scale"]
"""What to do where images are not of the size that their camera was calibrated at.

exact   refuse them, unless the aspect ratio is the same: then scale
crop    the images are the calibrated ones, cropped or extended at the right or the bottom
scale   they are the calibrated ones, scaled separately along each axis
"""


def read_views(paths: Sequence[tuple[str, Path]], cameras: Sequence[str]) -> Views:
    """Read calibration files, each with the camera it is of (or ''), for cameras in the rig's order.

    One file or folder that holds all cameras (our own, Caliscope, Qualisys, EasyMocap, COLMAP, nerfstudio),
    or one of each camera: OpenCV's (.npz, .yml, .yaml, .xml) with that of the pair, or a folder of them,
    and OpenCap's. Raises BadInputError for anything else.
    """
    for _, path in paths:
        if not path.exists():
            raise BadInputError(f"no calibration at {path}")
    first = paths[0][1]
    if is_opencap(first):
        return read_opencap(paths)
    views = _of_all(first, cameras)
    if views is None:
        return read_opencv(paths, cameras)
    if len(paths) > 1:
        raise BadInputError(f"{first} holds all cameras", hint="give that one only")
    return views


def _of_all(path: Path, cameras: Sequence[str]) -> Views | None:
    """The views of a file or folder that holds all cameras; None where it is of one camera or a pair."""
    for name in (CALIBRATION, "transforms.json") if path.is_dir() else ():
        if (path / name).is_file():
            path = path / name
    if path.suffix.lower() == ".toml":
        return read_caliscope(path)
    if path.suffix.lower() == ".json":
        return _read_json(path, cameras)
    if _is_qualisys(path):
        return read_qualisys(path)
    if is_easymocap(path):
        return read_easymocap(path)
    model = find_model(path)
    return None if model is None else read_colmap(model, cameras)


def fit_calibration(
    views: Views, sizes: Mapping[str, tuple[int, int]], *, unit: str | None = None, fit: Fit = "exact"
) -> Calibration:
    """The calibration of a recording's cameras, given their image sizes (width, height) in pixels.

    Lengths are converted to metres from the file's own unit, else from `unit` (default m); a unit that
    is not known (such as a board's square) is kept and named. Raises BadInputError where a camera has no
    calibration, where its numbers cannot be a camera's, or where the size does not fit.
    """
    if unit is not None and views.unit is not None and unit != views.unit:
        raise BadInputError(f"{views.source} is in {views.unit}, not in {unit}", hint="leave out --unit")
    given = views.unit or unit or views.assumed_unit
    labels = {match_name(label, list(sizes)): label for label in views.cameras}
    lacking = [name for name in sizes if name not in labels]
    if lacking:
        of = ", ".join(views.cameras)
        raise BadInputError(
            f"{views.source} calibrates {of}: nothing for {', '.join(lacking)} of the recording"
        )
    scale = METRES.get(given, 1.0)
    cameras = {
        name: _camera(f"{views.source}: camera {name}", views.cameras[labels[name]], size, scale, fit)
        for name, size in sizes.items()
    }
    return Calibration(cameras=cameras, unit="m" if given in METRES else given, source=views.source)


def _camera(where: str, view: View, size: tuple[int, int], metres: float, fit: Fit) -> CameraCalibration:
    if not np.isfinite(view.matrix).all():
        raise BadInputError(f"{where} has numbers that are not finite")
    (fx, skew, cx), (_, fy, cy), _ = view.matrix.tolist()
    camera = CameraCalibration(
        width=size[0],
        height=size[1],
        fx=fx,
        fy=fy,
        cx=cx,
        cy=cy,
        rotation=_rows(view.rotation),
        translation=(*(view.translation.ravel() * metres).tolist(),),
        distortion=(*view.distortion.ravel().tolist(),),
    )
    check_lens(where, camera)
    if abs(skew) > 0.01:
        raise BadInputError(f"{where} has a skew of {skew:.3g} pixels; only a skew of 0 is supported")
    if abs(view.matrix[2] - [0, 0, 1]).max() > 1e-6:
        raise BadInputError(f"{where} has no camera matrix: its last row is not 0, 0, 1")
    x, y = _factors(where, view.size, size, fit)
    left, _, right = np.linalg.svd(view.rotation)
    return msgspec.structs.replace(
        camera,
        fx=fx * x,
        fy=fy * y,
        cx=(cx + 0.5) * x - 0.5,
        cy=(cy + 0.5) * y - 0.5,
        rotation=_rows(left @ right),
        distortion=(*camera.distortion, *[0.0] * 5)[:5],
    )


def _factors(
    where: str, calibrated: tuple[int, int] | None, size: tuple[int, int], fit: Fit
) -> tuple[float, float]:
    if calibrated is None or calibrated == size:
        return 1.0, 1.0
    if min(calibrated) < 1:
        raise BadInputError(f"{where} is calibrated for {calibrated[0]}x{calibrated[1]} pixels")
    x, y = size[0] / calibrated[0], size[1] / calibrated[1]
    if fit == "crop":
        return 1.0, 1.0
    if fit == "scale" or abs(x / y - 1) < 1e-3:
        return x, y
    taken = f"{size[0]}x{size[1]}"
    turned = "; are they turned by 90 degrees?" if calibrated == size[::-1] else ""
    raise BadInputError(
        f"{where} is calibrated for {calibrated[0]}x{calibrated[1]} pixels, its images are {taken}{turned}",
        hint="--fit crop if their right or bottom is cut off, --fit scale if they are stretched",
    )


def _rows(matrix: Array) -> Matrix3:
    first, second, third = (tuple(row) for row in matrix.tolist())
    return first, second, third


def _is_qualisys(path: Path) -> bool:
    if path.is_dir() or path.suffix.lower() not in (".txt", ".xml"):
        return False
    with path.open("rb") as file:
        return b"<calibration" in file.read(4096)


def _read_json(path: Path, cameras: Sequence[str]) -> Views:
    """Read a calibration.json, transforms.json or rig_config.json. Raises BadInputError for anything else."""
    try:
        content = msgspec.json.decode(path.read_bytes())
    except OSError as error:
        raise BadInputError(f"cannot read {path}: {error.strerror}") from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise BadInputError(f"{path} is not JSON: {error}") from error
    if isinstance(content, dict) and isinstance(content.get("frames"), list):
        return _views_of_transforms(path, content, cameras)
    rigs = content if isinstance(content, list) else []
    if rigs and all(isinstance(rig, dict) and isinstance(rig.get("cameras"), list) for rig in rigs):
        return views_of_rig_config(path, rigs)
    if isinstance(content, dict) and isinstance(content.get("cameras"), dict):
        own = read_struct(path, Calibration, 1)
        views = {
            name: View(
                matrix=pinhole(of.fx, of.fy, of.cx, of.cy),
                distortion=np.array(of.distortion, np.float64),
                rotation=np.array(of.rotation, np.float64),
                translation=np.array(of.translation, np.float64),
                size=(of.width, of.height),
            )
            for name, of in own.cameras.items()
        }
        return Views(views, own.source or path.name, own.unit)
    hint = "known: simulshot's calibration.json, nerfstudio's transforms.json, COLMAP's rig_config.json"
    raise BadInputError(f"{path} is not a calibration", hint=hint)


_HALF_PIXEL = 0.5
_PERSPECTIVE = ("OPENCV", "PINHOLE", "PERSPECTIVE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
_OPENCV_FROM_OPENGL = np.array([1.0, -1.0, -1.0])


def _views_of_transforms(path: Path, content: Mapping[str, Any], cameras: Sequence[str]) -> Views:
    """The cameras of a decoded transforms.json; an image is of the camera that its path names.

    The unit is arbitrary unless the file has `unit`, as our own exports do. Raises BadInputError, with the
    image, for what is missing, for fisheye lenses and for cameras that move.
    """
    if not content["frames"]:
        raise BadInputError(f"{path} has no frames", hint="is it nerfstudio's transforms.json?")
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
        raise BadInputError(f"{where} has no number {key}")
    return float(value)
