"""COLMAP's calibrations: a sparse model, text or binary, or a `rig_config.json` of its sensors.

Sources: colmap.github.io/format.html, cameras.html and rigs.html, and COLMAP 4's
src/colmap/scene/reconstruction_io_{text,binary}.cc. cam_from_world is a quaternion (w, x, y, z) and a
translation, camera axes are OpenCV's, the first pixel's centre is (0.5, 0.5). A model has no absolute scale.
Binary files are little-endian.
"""

import struct
from collections.abc import Callable, Iterator, Sequence
from io import BytesIO
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.session.files.untrusted_files import read_input, rejecting
from capture_app.session.format.lens import Array
from capture_app.session.importing.importer import Importer
from capture_app.session.importing.views import (
    EXPORT_AGAIN,
    View,
    Views,
    camera_of,
    from_quaternion,
    numbers,
    pinhole,
    read_json,
    views_of_images,
)

MODELS = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV")
"""Supported camera models; the index is the number in binary files."""
COUNTS = dict(enumerate((3, 4, 4, 5, 8, 8, 12, 5, 4, 5, 12, 16, 4, 5, 3, 4, 6, 2)))
"""Number of parameters of each of COLMAP's models, by its number."""
_PLACES = (".", "sparse/0", "sparse", "0")
_HALF_PIXEL = 0.5
_ARBITRARY = "arbitrary"
_USE_MODEL = "give COLMAP's model, sparse/0"
_LENSES: dict[str, Callable[..., tuple[float, ...]]] = {
    "SIMPLE_PINHOLE": lambda f, x, y: (f, f, x, y),
    "PINHOLE": lambda *all_: all_,
    "SIMPLE_RADIAL": lambda f, x, y, k: (f, f, x, y, k),
    "RADIAL": lambda f, x, y, k1, k2: (f, f, x, y, k1, k2),
    "OPENCV": lambda *all_: all_,
    "OPENCV_FISHEYE": lambda *all_: all_,
    "FULL_OPENCV": lambda *all_: all_,
}
"""Converts a model's parameters to fx, fy, cx, cy and OpenCV's distortion, or its fisheye's."""
_HERE = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

Pose = tuple[float, ...]
"""Quaternion w, x, y, z and translation of x_cam = R x + t."""
Rig = dict[int, Pose]
"""The pose of each sensor in its rig, by its camera's number."""


Lens = tuple[str, tuple[float, ...], tuple[int, int]]
"""A lens: model, parameters in COLMAP's order, and image width and height in px."""
Image = tuple[str, int, Pose]
"""An image: path, the number of its camera, and its pose in the world."""


def read_calibration(paths: Sequence[tuple[str, Path]], cameras: Sequence[str]) -> Views | None:
    """Read a model's folder, or a rig_config.json. Raises BadInputError if malformed, or if cameras move."""
    path = paths[0][1]
    content = read_json(path)
    rigs = content if isinstance(content, list) else []
    if rigs and all(isinstance(rig, dict) and isinstance(rig.get("cameras"), list) for rig in rigs):
        return views_of_rig_config(path, rigs)
    models = (path / place for place in _PLACES if _file(path / place, "cameras") is not None)
    model = next(models, None)
    return None if model is None else read_colmap(model, cameras)


def read_colmap(folder: Path, cameras: Sequence[str]) -> Views:
    """Return the cameras of a model, in its world; an image's path names its camera.

    If a rig's images have several poses, only the rig's sensors are fixed relative to each other; then the
    first sensor is the origin. Raises BadInputError if the model is malformed, not perspective, or if cameras
    move.
    """
    lenses: dict[int, Lens] = dict(_read(folder, "cameras"))
    images: list[Image] = _read(folder, "images")
    rigs: list[Rig] = _read(folder, "rigs") if _file(folder, "rigs") else []
    if not images:
        raise BadInputError(f"{folder} has no images", hint="give a model with registered images")

    def view(name: str, number: int, pose: Pose) -> View:
        where = f"{folder}: {name}"
        if number not in lenses:
            raise BadInputError(f"{where} is of camera {number}, which the model lacks", hint=EXPORT_AGAIN)
        model, parameters, size = lenses[number]
        return _view(where, model, parameters, pose, size)

    remedy = "" if len(rigs) == 1 else ": give a model of one instant, or one made with rig_config.json"
    of_images = [(camera_of(name, cameras), view(name, key, pose)) for name, key, pose in images]
    try:
        views = views_of_images(str(folder), of_images, f"a rig stands still{remedy}")
    except BadInputError:
        if len(rigs) != 1 or len(rigs[0]) < 2:
            raise
        names = {key: camera_of(name, cameras) for name, key, _ in images}
        views = {names[key]: view(names[key], key, pose) for key, pose in rigs[0].items() if key in names}
    return Views(views, f"COLMAP model {'/'.join(folder.parts[-2:])}", assumed_unit=_ARBITRARY)


def views_of_rig_config(path: Path, content: Sequence[Any]) -> Views:
    """Return the cameras of a decoded rig_config.json; a camera's name is its image_prefix's last folder.

    Raises BadInputError if a sensor has no pose or no lens, or if the file describes several rigs.
    """
    if len(content) != 1:
        raise BadInputError(f"{path} describes {len(content)} rigs", hint="keep the one of the recording")
    views = {}
    for sensor in content[0]["cameras"]:
        if not isinstance(sensor, dict):
            raise BadInputError(f"{path} has a camera that is no object", hint=_USE_MODEL)
        name = (PurePosixPath(str(sensor.get("image_prefix", ""))).parts or ("",))[-1]
        where = f"{path}: camera {name}"
        parameters = numbers(where, sensor, "camera_params", *COUNTS.values(), hint=_USE_MODEL)
        pose = _HERE
        if not sensor.get("ref_sensor", False):
            parts = [
                numbers(where, sensor, f"cam_from_rig_{part}", length, hint=_USE_MODEL)
                for part, length in (("rotation", 4), ("translation", 3))
            ]
            pose = (*np.concatenate(parts).tolist(),)
        views[name] = _view(where, str(sensor.get("camera_model_name")), parameters, pose, None)
    return Views(views, path.name, assumed_unit=_ARBITRARY)


def _view(
    where: str,
    model: str,
    parameters: Sequence[float] | Array,
    pose: Sequence[float],
    size: tuple[int, int] | None,
) -> View:
    if model not in _LENSES:
        raise BadInputError(
            f"{where} has COLMAP's camera model {model}", hint=f"supported are {', '.join(_LENSES)}"
        )
    count = COUNTS[MODELS.index(model)]
    if len(parameters) != count:
        raise BadInputError(
            f"{where} has {len(parameters)} parameters; {model} has {count}", hint=EXPORT_AGAIN
        )
    is_fisheye = model == "OPENCV_FISHEYE"
    fx, fy, x, y, *distortion = _LENSES[model](*map(float, parameters))
    return View(
        matrix=pinhole(fx, fy, x - _HALF_PIXEL, y - _HALF_PIXEL),
        distortion=np.array([*distortion, *[0.0] * 5][: max(4 if is_fisheye else 5, len(distortion))]),
        rotation=from_quaternion(where, pose[:4]),
        translation=np.array(pose[4:7], np.float64),
        size=size,
        is_fisheye=is_fisheye,
    )


def _file(folder: Path, name: str) -> Path | None:
    """Return a file of a model, binary or text, or None."""
    return next((path for end in ("bin", "txt") if (path := folder / f"{name}.{end}").is_file()), None)


def _read(folder: Path, name: str) -> list[Any]:
    """Read a file of a model. Raises BadInputError, with the file, if it is malformed or missing."""
    path = _file(folder, name) or folder / f"{name}.txt"
    data = read_input(path)
    with rejecting(
        f"{path} is not COLMAP's", ValueError, LookupError, OverflowError, struct.error, hint=EXPORT_AGAIN
    ):
        if path.suffix == ".bin":
            return list(_BINARY[name](BytesIO(data)))
        lines = data.decode("utf-8-sig").splitlines()
        return list(_TEXT[name]([line.split() for line in lines if not line.startswith("#")]))


def _text_cameras(lines: list[list[str]]) -> Iterator[tuple[int, Lens]]:
    for number, model, width, height, *parameters in filter(None, lines):
        yield int(number), (model, tuple(map(float, parameters)), (int(width), int(height)))


def _text_images(lines: list[list[str]]) -> Iterator[Image]:
    # Every second line has the image's points, and may be empty.
    first = next((n for n, line in enumerate(lines) if line), 0)
    for words in filter(None, lines[first::2]):
        yield " ".join(words[9:]), int(words[8]), _pose(words[1:8])


def _text_rigs(lines: list[list[str]]) -> Iterator[Rig]:
    for _, _, *rest in filter(None, lines):
        kind, key, *rest = rest
        sensors: Rig = {int(key): _HERE} if kind == "CAMERA" else {}
        while rest:
            kind, key, posed = rest[:3]
            if kind == "CAMERA" and int(posed):
                sensors[int(key)] = _pose(rest[3:10])
            rest = rest[10 if int(posed) else 3 :]
        yield sensors


def _pose(words: list[str]) -> Pose:
    if len(words) != 7:
        raise ValueError("a pose does not have seven numbers")
    return tuple(map(float, words))


def _take(file: BytesIO, layout: str) -> tuple[Any, ...]:
    return struct.unpack(f"<{layout}", file.read(struct.calcsize(f"<{layout}")))


def _binary_cameras(file: BytesIO) -> Iterator[tuple[int, Lens]]:
    for _ in range(*_take(file, "Q")):
        key, model, width, height = _take(file, "IiQQ")
        name = MODELS[model] if 0 <= model < len(MODELS) else f"number {model}"
        yield key, (name, _take(file, f"{COUNTS[model]}d"), (width, height))


def _binary_images(file: BytesIO) -> Iterator[Image]:
    for _ in range(*_take(file, "Q")):
        _, *pose, camera = _take(file, "I7dI")
        name, begin = file.getvalue(), file.tell()
        end = name.index(b"\0", begin)
        file.seek(end + 1)
        file.seek(24 * _take(file, "Q")[0], 1)
        yield name[begin:end].decode("utf-8"), camera, tuple(pose)


def _binary_rigs(file: BytesIO) -> Iterator[Rig]:
    for _ in range(*_take(file, "Q")):
        sensors: Rig = {}
        for place in range(_take(file, "II")[1]):
            kind, key = _take(file, "iI")
            pose = _HERE if place == 0 else _take(file, "7d") if _take(file, "B")[0] else None
            if kind == 0 and pose is not None:  # SensorType::CAMERA
                sensors[key] = pose
        yield sensors


_TEXT: dict[str, Callable[[list[list[str]]], Iterator[Any]]] = {
    "cameras": _text_cameras,
    "images": _text_images,
    "rigs": _text_rigs,
}
_BINARY: dict[str, Callable[[BytesIO], Iterator[Any]]] = {
    "cameras": _binary_cameras,
    "images": _binary_images,
    "rigs": _binary_rigs,
}


IMPORTER = Importer(
    program="COLMAP",
    help="a sparse model's folder, or rig_config.json, as a calibration",
    read_calibration=read_calibration,
    calibration_files=("rig_config.json", "sparse/0"),
    priority=-2,
)
