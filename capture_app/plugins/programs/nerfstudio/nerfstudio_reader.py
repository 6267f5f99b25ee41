"""nerfstudio's transforms.json: a pose for every image, in OpenGL's camera axes.

A folder whose images are all in one place, as NeRF's captures are, is a rig with a camera for each image. A
rig's folder for each camera is read as any folder of cameras.

Sources: docs.nerf.studio ("Nerfstudio dataset format") and
nerfstudio/data/dataparsers/nerfstudio_dataparser.py. fl_x, fl_y, cx, cy, w, h and the distortion k1, k2, k3,
p1, p2 are given for each frame or once for all. `transform_matrix` is the camera's pose in the world: x
right, y up, z backwards. The first pixel's centre is (0.5, 0.5). Older files give camera_angle_x, the
horizontal field of view in radians, instead of fl_x.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.common.names import IMAGE_SUFFIXES, name_like
from capture_app.common.text import count
from capture_app.session.format.calibration import TERMS
from capture_app.session.format.manifest import inside
from capture_app.session.importing.importer import Importer
from capture_app.session.importing.recording_sources import Images, Layout, image_folder
from capture_app.session.importing.views import (
    EXPORT_AGAIN,
    View,
    Views,
    camera_of,
    number,
    numbers,
    pinhole,
    read_json,
    views_of_images,
)
from capture_app.session.reading.decoding import image_size

_TRANSFORMS = "transforms.json"
_HALF_PIXEL = 0.5
_PERSPECTIVE = ("OPENCV", "PINHOLE", "PERSPECTIVE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
_OPENCV_FROM_OPENGL = np.array([1.0, -1.0, -1.0])


def open_recording(path: Path, *, png: bool, recording: str | None) -> Layout | None:
    """Open a folder with a transforms.json and all images in one place: each is a camera of one instant.

    Images that are absent are left out, and a folder with images of several times is not read here. Raises
    BadInputError as `read_calibration` does.
    """
    source = path / _TRANSFORMS
    content = (_read(source) if source.is_file() else None) or {"frames": []}
    by_file = {
        frame["file_path"]: frame
        for frame in content["frames"]
        if isinstance(frame, dict) and isinstance(frame.get("file_path"), str)
    }
    if len({(PurePosixPath(file).parent, str(frame.get("time"))) for file, frame in by_file.items()}) != 1:
        return None
    sources: dict[str, Images] = {}
    views: dict[str, View] = {}
    for file, frame in by_file.items():
        # Synthetic scenes leave out the suffix, and the size.
        point_cloud = next(
            (at for end in ("", *IMAGE_SUFFIXES) if (at := inside(path, file + end)).is_file()), None
        )
        if point_cloud is not None:
            name = name_like(point_cloud.stem, f"cam{len(sources)}")
            sources[name] = image_folder(name, point_cloud)
            size = (
                {}
                if "w" in content | frame
                else dict(zip("wh", image_size(point_cloud.read_bytes()) or (), strict=False))
            )
            _, views[name] = _image(source, {**content, **size}, frame, ())
    if len(sources) < 2:
        return None
    return Layout(
        path=path,
        sources=tuple(sources.values()),
        views=_views(source, content, views),
        notes=[
            f"{len(sources)} of {count(len(by_file), 'image')} are there; each is a camera of one instant"
        ],
    )


def _read(path: Path) -> dict[str, Any] | None:
    content = read_json(path)
    return content if isinstance(content, dict) and isinstance(content.get("frames"), list) else None


def _views(path: Path, content: Mapping[str, Any], views: Mapping[str, View]) -> Views:
    unit = content.get("unit")
    return Views(views, path.name, unit if isinstance(unit, str) else None, assumed_unit="arbitrary")


def read_calibration(paths: Sequence[tuple[str, Path]], cameras: Sequence[str]) -> Views | None:
    """Read the cameras of a transforms.json or of its folder; an image's path names its camera.

    The unit is arbitrary unless the file has `unit`, as our own exports do. Raises BadInputError, with the
    image, for missing values, other lens models and cameras that move.
    """
    path = paths[0][1]
    path = path / _TRANSFORMS if (path / _TRANSFORMS).is_file() else path
    if (content := _read(path)) is None:
        return None
    if not content["frames"]:
        raise BadInputError(f"{path} has no frames", hint="give one whose list frames has each camera")
    images = [_image(path, content, frame, cameras) for frame in content["frames"]]
    # If all cameras of the recording are named, it may be a part of the file's.
    if {label for label, _ in images} >= set(cameras):
        images = [image for image in images if image[0] in cameras]
    hint = "a rig stands still: give the file of one instant, with one image a camera"
    return _views(path, content, views_of_images(str(path), images, hint))


def _image(path: Path, content: Mapping[str, Any], frame: Any, cameras: Sequence[str]) -> tuple[str, View]:
    if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str):
        raise BadInputError(f"{path} has a frame without a file_path", hint=EXPORT_AGAIN)
    file, all_of = frame["file_path"], {**content, **frame}
    where = f"{path}: {file}"
    model = str(all_of.get("camera_model", "OPENCV")).upper()
    is_fisheye = model == "OPENCV_FISHEYE"
    if (model not in _PERSPECTIVE or all_of.get("is_fisheye")) and not is_fisheye:
        raise BadInputError(
            f"{where} is of a {model} camera; only perspective ones and OPENCV_FISHEYE are supported",
            hint="undistort the images to a perspective camera and calibrate again",
        )
    if number(where, all_of, "k4", 0.0) and not is_fisheye:
        raise BadInputError(
            f"{where} has a distortion k4; k1, k2, p1, p2, k3 are supported",
            hint="calibrate with k1, k2, p1, p2, k3",
        )
    name = frame.get("camera")
    label = name if isinstance(name, str) else camera_of(file, cameras)
    pose = numbers(where, all_of, "transform_matrix", 12, 16).reshape(-1, 4)
    rotation = (pose[:3, :3] * _OPENCV_FROM_OPENGL).T
    width, height = (round(number(where, all_of, key)) for key in ("w", "h"))
    fx = number(where, all_of, "fl_x", _focal_length(where, all_of, "camera_angle_x", width))
    fy = number(where, all_of, "fl_y", _focal_length(where, all_of, "camera_angle_y", height) or fx)
    cx, cy = (number(where, all_of, key, side / 2) for key, side in (("cx", width), ("cy", height)))
    view = View(
        matrix=pinhole(fx, fy, cx - _HALF_PIXEL, cy - _HALF_PIXEL),
        distortion=np.array([number(where, all_of, key, 0.0) for key in TERMS[is_fisheye]]),
        rotation=rotation,
        translation=-rotation @ pose[:3, 3],
        size=(width, height),
        is_fisheye=is_fisheye,
    )
    return label, view


def _focal_length(where: str, given: Mapping[str, Any], key: str, pixels: int) -> float | None:
    if key not in given:
        return None
    angle = number(where, given, key)
    if not 0 < angle < math.pi:
        raise BadInputError(f"{where} has the {key} {angle:g}", hint="it is in radians, between 0 and pi")
    return pixels / 2 / math.tan(angle / 2)


IMPORTER = Importer(
    program="nerfstudio",
    help="transforms.json with its images, one a camera; it, or its folder, as a calibration",
    open_recording=open_recording,
    read_calibration=read_calibration,
    calibration_files=(_TRANSFORMS,),
)
