"""COLMAP's calibrations: a sparse model, or a `rig_config.json` with the poses and lenses of its sensors.

Conventions of colmap.github.io/format.html, cameras.html and rigs.html: cam_from_world as quaternion
(w, x, y, z) and translation, camera axes as OpenCV's, the first pixel's centre at (0.5, 0.5). A model has no
scale of its own.

COLMAP's model files, text or binary, as far as a calibration needs them.

By colmap.github.io/format.html and COLMAP 4's src/colmap/scene/reconstruction_io_{text,binary}.cc: cameras,
images, and since COLMAP 3.12 rigs. Binary files are little-endian.
"""

import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, TypeVar

import numpy as np

from capture_app.errors import BadInputError
from capture_app.session.importers.calibrations.views import (
    Array,
    View,
    Views,
    camera_of,
    from_quaternion,
    views_of_images,
)

MODELS = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV")
"""Camera models by their number in binary files, as far as any is supported."""
COUNTS = dict(enumerate((3, 4, 4, 5, 8, 8, 12, 5, 4, 5, 12, 16, 4, 5, 3, 4, 6, 2)))
"""How many parameters each of COLMAP's models has, by its number."""
_CAMERA = "CAMERA"

Pose = tuple[float, ...]
"""Quaternion w, x, y, z and translation of x_cam = R x + t."""
Key = TypeVar("Key")


@dataclass(frozen=True, slots=True)
class ColmapCamera:
    """A lens: its model, its size in pixels, and its parameters in COLMAP's order."""

    model: str
    width: int
    height: int
    parameters: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class ColmapImage:
    """An image: its path, the number of its camera, and its pose in the world."""

    name: str
    camera: int
    pose: Pose


@dataclass(frozen=True, slots=True)
class ColmapModel:
    """Cameras by number, images, and for each rig the pose of its sensors by camera number."""

    folder: Path
    cameras: Mapping[int, ColmapCamera]
    images: tuple[ColmapImage, ...]
    rigs: tuple[Mapping[int, Pose], ...]


def find_model(path: Path) -> Path | None:
    """The folder of a model: the path itself, or its `sparse/0` or `sparse`; None where there is none."""
    for folder in (path, path / "sparse" / "0", path / "sparse", path / "0"):
        if any((folder / f"cameras{suffix}").is_file() for suffix in (".bin", ".txt")):
            return folder
    return None


def read_model(folder: Path) -> ColmapModel:
    """Read a model. Raises BadInputError, with the file, for one that is broken or lacks a file."""
    binary = (folder / "cameras.bin").is_file()
    suffix = ".bin" if binary else ".txt"
    cameras = _read(folder / f"cameras{suffix}", _binary_cameras if binary else _text_cameras)
    images = _read(folder / f"images{suffix}", _binary_images if binary else _text_images)
    rigs = folder / f"rigs{suffix}"
    sensors = _read(rigs, _binary_rigs if binary else _text_rigs) if rigs.is_file() else []
    return ColmapModel(folder, dict(cameras), tuple(images), tuple(sensors))


def _read(path: Path, parse: Callable[[bytes], Iterator[Key]]) -> list[Key]:
    try:
        return list(parse(path.read_bytes()))
    except OSError as error:
        raise BadInputError(f"cannot read {path}: {error.strerror}") from error
    except (ValueError, IndexError, KeyError, struct.error) as error:
        raise BadInputError(f"{path} is not COLMAP's: {error}") from error


def _lines(data: bytes) -> Iterator[list[str]]:
    """The words of every line that is no comment; an empty line has none."""
    for line in data.decode("utf-8").splitlines():
        if not line.startswith("#"):
            yield line.split()


def _text_cameras(data: bytes) -> Iterator[tuple[int, ColmapCamera]]:
    for words in filter(None, _lines(data)):
        parameters = tuple(map(float, words[4:]))
        yield int(words[0]), ColmapCamera(words[1], int(words[2]), int(words[3]), parameters)


def _text_images(data: bytes) -> Iterator[ColmapImage]:
    # Every second line has the image's points, and may be empty.
    lines = list(_lines(data))
    while lines and not lines[0]:
        lines.pop(0)
    for words in lines[::2]:
        if words:
            name = " ".join(words[9:])
            yield ColmapImage(name, int(words[8]), _pose(words[1:8]))


def _text_rigs(data: bytes) -> Iterator[dict[int, Pose]]:
    for words in filter(None, _lines(data)):
        sensors: dict[int, Pose] = {}
        rest = words[2:]
        if rest[0] == _CAMERA:
            sensors[int(rest[1])] = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        rest = rest[2:]
        while rest:
            posed = int(rest[2]) != 0
            if rest[0] == _CAMERA and posed:
                sensors[int(rest[1])] = _pose(rest[3:10])
            rest = rest[10 if posed else 3 :]
        yield sensors


def _pose(words: list[str]) -> Pose:
    if len(words) != 7:
        raise ValueError("a pose does not have seven numbers")
    return tuple(map(float, words))


class _Bytes:
    """Reads numbers one after the other."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    def take(self, layout: str) -> tuple[float, ...]:
        found = struct.unpack_from(f"<{layout}", self._data, self._at)
        self._at += struct.calcsize(f"<{layout}")
        return found

    def count(self, layout: str) -> int:
        return int(self.take(layout)[0])

    def text(self) -> str:
        end = self._data.index(b"\0", self._at)
        found, self._at = self._data[self._at : end].decode("utf-8"), end + 1
        return found

    def skip(self, count: int) -> None:
        self._at += count


def _binary_cameras(data: bytes) -> Iterator[tuple[int, ColmapCamera]]:
    numbers = _Bytes(data)
    for _ in range(numbers.count("Q")):
        key, model, width, height = (int(n) for n in numbers.take("IiQQ"))
        name = MODELS[model] if 0 <= model < len(MODELS) else f"number {model}"
        yield key, ColmapCamera(name, width, height, numbers.take(f"{COUNTS[model]}d"))


def _binary_images(data: bytes) -> Iterator[ColmapImage]:
    numbers = _Bytes(data)
    for _ in range(numbers.count("Q")):
        numbers.take("I")
        pose = numbers.take("7d")
        camera, name = numbers.count("I"), numbers.text()
        numbers.skip(24 * numbers.count("Q"))
        yield ColmapImage(name, camera, pose)


def _binary_rigs(data: bytes) -> Iterator[dict[int, Pose]]:
    numbers = _Bytes(data)
    for _ in range(numbers.count("Q")):
        count = int(numbers.take("II")[1])
        sensors: dict[int, Pose] = {}
        for place in range(count):
            kind, key = (int(n) for n in numbers.take("iI"))
            if place == 0:
                pose: Pose | None = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
            else:
                pose = numbers.take("7d") if numbers.count("B") else None
            if kind == 0 and pose is not None:  # SensorType::CAMERA
                sensors[key] = pose
        yield sensors


_HALF_PIXEL = 0.5
_ARBITRARY = "arbitrary"
_LENSES: dict[str, tuple[int, Callable[..., tuple[float, ...]]]] = {
    "SIMPLE_PINHOLE": (3, lambda f, x, y: (f, f, x, y)),
    "PINHOLE": (4, lambda *all_: all_),
    "SIMPLE_RADIAL": (4, lambda f, x, y, k: (f, f, x, y, k)),
    "RADIAL": (5, lambda f, x, y, k1, k2: (f, f, x, y, k1, k2)),
    "OPENCV": (8, lambda *all_: all_),
    "FULL_OPENCV": (12, lambda *all_: all_),
}
"""By model, how many parameters it has, and they as fx, fy, cx, cy and OpenCV's distortion."""


def read_colmap(folder: Path, cameras: Sequence[str]) -> Views:
    """The cameras of a model, in its world; an image is of the camera that its path names.

    Where a rig's images have several poses, it is the rig's sensors that stand still against each other: then
    the first sensor is the origin. Raises BadInputError for what is broken, not perspective, or moves.
    """
    model = read_model(folder)
    if not model.images:
        raise BadInputError(f"{folder} has no images", hint="is the model empty?")
    try:
        views = views_of_images(str(folder), _images(model, cameras), _hint(model))
    except BadInputError:
        if len(model.rigs) != 1 or len(model.rigs[0]) < 2:
            raise
        views = _of_rig(model, model.rigs[0], cameras)
    return Views(views, f"COLMAP model {'/'.join(folder.parts[-2:])}", assumed_unit=_ARBITRARY)


def views_of_rig_config(path: Path, content: Sequence[Any]) -> Views:
    """The cameras of a decoded rig_config.json; a camera's name is the last folder of its image_prefix.

    Raises BadInputError where a sensor has no pose or no lens, or where it describes several rigs.
    """
    if len(content) != 1:
        raise BadInputError(f"{path} describes {len(content)} rigs", hint="keep the one of the recording")
    views = {}
    for sensor in content[0]["cameras"]:
        prefix = str(sensor.get("image_prefix", ""))
        name = (PurePosixPath(prefix).parts or ("",))[-1]
        where = f"{path}: camera {name}"
        reference = sensor.get("ref_sensor", False)
        rotation, translation = (sensor.get(f"cam_from_rig_{part}") for part in ("rotation", "translation"))
        if reference:
            rotation, translation = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        if rotation is None or translation is None:
            raise BadInputError(f"{where} has no cam_from_rig", hint="give COLMAP's model, sparse/0")
        if "camera_model_name" not in sensor or "camera_params" not in sensor:
            raise BadInputError(f"{where} has no camera_params", hint="give COLMAP's model, sparse/0")
        lens = _lens(where, sensor["camera_model_name"], sensor["camera_params"])
        views[name] = _view(where, lens, (*rotation, *translation), None)
    return Views(views, path.name, assumed_unit=_ARBITRARY)


def _hint(model: ColmapModel) -> str:
    joined = "a rig stands still: give a model of one instant, or one made with rig_config.json"
    return joined if len(model.rigs) != 1 else "a rig stands still"


def _images(model: ColmapModel, cameras: Sequence[str]) -> list[tuple[str, View]]:
    return [
        (camera_of(image.name, cameras), _of_model(model, image.name, image.camera, image.pose))
        for image in model.images
    ]


def _of_rig(model: ColmapModel, sensors: Mapping[int, Pose], cameras: Sequence[str]) -> dict[str, View]:
    names = {image.camera: camera_of(image.name, cameras) for image in model.images}
    return {
        names[key]: _of_model(model, names[key], key, pose) for key, pose in sensors.items() if key in names
    }


def _of_model(model: ColmapModel, name: str, key: int, pose: Pose) -> View:
    where = f"{model.folder}: {name}"
    camera = model.cameras.get(key)
    if camera is None:
        raise BadInputError(f"{where} is of camera {key}, which the model lacks")
    return _view(where, _lens(where, camera.model, camera.parameters), pose, (camera.width, camera.height))


def _lens(where: str, model: str, parameters: Sequence[float]) -> tuple[float, ...]:
    if model not in _LENSES:
        raise BadInputError(
            f"{where} has COLMAP's camera model {model}", hint=f"supported are {', '.join(_LENSES)}"
        )
    count, arrange = _LENSES[model]
    if len(parameters) != count:
        raise BadInputError(f"{where} has {len(parameters)} parameters; {model} has {count}")
    return arrange(*map(float, parameters))


def _view(where: str, lens: tuple[float, ...], pose: Sequence[float], size: tuple[int, int] | None) -> View:
    fx, fy, x, y, *distortion = lens
    distorted: Array = np.array([*distortion, *[0.0] * (5 - len(distortion))])
    return View(
        matrix=np.array([[fx, 0, x - _HALF_PIXEL], [0, fy, y - _HALF_PIXEL], [0, 0, 1]]),
        distortion=distorted,
        rotation=from_quaternion(where, pose[:4]),
        translation=np.array(pose[4:7], np.float64),
        size=size,
    )
