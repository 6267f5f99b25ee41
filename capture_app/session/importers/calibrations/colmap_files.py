"""COLMAP's model files, text or binary, as far as a calibration needs them.

By colmap.github.io/format.html and COLMAP 4's src/colmap/scene/reconstruction_io_{text,binary}.cc: cameras,
images, and since COLMAP 3.12 rigs. Binary files are little-endian.
"""

import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from capture_app.errors import BadInputError

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
