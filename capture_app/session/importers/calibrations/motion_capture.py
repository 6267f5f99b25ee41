"""Calibrations of Caliscope, EasyMocap, OpenCap, Qualisys.

Caliscope's `camera_array.toml` (and Anipose's, which has the same tables): lengths in metres.

EasyMocap's calibration: `intri.yml` and `extri.yml` in one folder, in OpenCV's YAML.

Keys and conventions are those of its easymocap/mytools/camera_utils.py (read_camera, write_camera): `names`
lists the cameras; K_NAME and dist_NAME (older: D_NAME) are OpenCV's, R_NAME a Rodrigues vector and T_NAME
the translation of x_cam = R x_world + T, H_NAME and W_NAME the images' size where it was known.

OpenCap's `Videos/CamN/cameraIntrinsicsExtrinsics.pickle`: a camera each, lengths in mm.

By opencap-core's utilsChecker.py: intrinsicMat 3x3, distortion (1, 5), imageSize (height, width), rotation
3x3 and translation of x_cam = R x_board + t, the board's squares in mm. A pickle can hold anything, also
programs: arrays and numbers are taken, all else is refused.

Qualisys Track Manager's calibration (.qca.txt, XML): lengths in mm, pixels in 64ths.

Its cameras look along -z with y up, and `transform` holds the camera's axes as rows (r11 r12 r13 is the
camera's x axis in the room) and its position. The distortion is OpenCV's, in units of the focal length:
of all numbers it alone is not in 64ths.
"""

import io
import pickle
import tomllib
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from capture_app.errors import BadInputError
from capture_app.session.importers.calibrations.opencv import read_storage
from capture_app.session.importers.calibrations.views import Array, View, Views, from_rodrigues


def read_caliscope(path: Path) -> Views:
    """Read the cameras of a Caliscope or Anipose TOML; a rotation is a matrix or a Rodrigues vector.

    Raises BadInputError, with the camera, for what is broken or not yet calibrated.
    """
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise BadInputError(f"cannot read the calibration {path}: {error}") from error
    inner = content.get("cameras")
    tables = inner if isinstance(inner, dict) else content
    found = {key: table for key, table in tables.items() if isinstance(table, dict) and "matrix" in table}
    if not found:
        raise BadInputError(
            f"{path} has no camera with a matrix", hint="is it Caliscope's camera_array.toml?"
        )
    views = {}
    for key, table in found.items():
        label = str(table.get("name", table.get("cam_id", table.get("port", key))))
        views[label] = _caliscope_view(f"{path}: camera {label}", table)
    return Views(views, path.name)


def _caliscope_view(where: str, table: dict[str, Any]) -> View:
    size = _caliscope_numbers(where, table, "size", 2)
    rotation = _caliscope_numbers(where, table, "rotation", 3, 9)
    return View(
        matrix=_caliscope_numbers(where, table, "matrix", 9).reshape(3, 3),
        distortion=_caliscope_numbers(where, table, "distortions", 4, 5, 8),
        rotation=rotation.reshape(3, 3) if rotation.size == 9 else from_rodrigues(rotation),
        translation=_caliscope_numbers(where, table, "translation", 3),
        size=(int(size[0]), int(size[1])),
    )


def _caliscope_numbers(where: str, table: dict[str, Any], key: str, *counts: int) -> Array:
    try:
        values = np.asarray(table[key], np.float64).ravel()
    except KeyError:
        raise BadInputError(f"{where} has no {key}", hint="is the calibration complete?") from None
    except (TypeError, ValueError):
        raise BadInputError(f"{where}: {key} is not made of numbers") from None
    if values.size not in counts:
        raise BadInputError(f"{where}: {key} has {values.size} numbers, not {' or '.join(map(str, counts))}")
    return values


INTRINSICS, EXTRINSICS = "intri.yml", "extri.yml"
LONGEST_SIDE_PX = 1e6
Content = dict[str, Any]


def is_easymocap(path: Path) -> bool:
    """Whether a path is a folder with both files, or one of them."""
    folder = path if path.is_dir() else path.parent
    named = path.is_dir() or path.name in (INTRINSICS, EXTRINSICS)
    return named and any((folder / name).is_file() for name in (INTRINSICS, EXTRINSICS))


def read_easymocap(path: Path) -> Views:
    """Read both files of a folder, or of the folder of one of them. Raises BadInputError for what lacks."""
    folder = path if path.is_dir() else path.parent
    for name in (INTRINSICS, EXTRINSICS):
        if not (folder / name).is_file():
            raise BadInputError(
                f"no {name} in {folder}", hint=f"EasyMocap needs both: {INTRINSICS}, {EXTRINSICS}"
            )
    lenses, poses = read_storage(folder / INTRINSICS), read_storage(folder / EXTRINSICS)
    names = _names(folder / INTRINSICS, lenses)
    views = {name: _easymocap_view(folder, name, lenses, poses) for name in names}
    return Views(views, f"{INTRINSICS}, {EXTRINSICS}")


def _names(where: Path, storage: Content) -> list[str]:
    listed = storage.get("names")
    names = [
        f"{name:g}" if isinstance(name, int | float) else str(name)
        for name in (listed if isinstance(listed, list) else ())
    ]
    names = [name for name in names if name not in ("", "none")]
    if not names:
        raise BadInputError(f"{where} has no list of cameras, names", hint="is it EasyMocap's?")
    return names


def _easymocap_view(folder: Path, name: str, lenses: Content, poses: Content) -> View:
    where = f"{folder}: camera {name}"
    distortion = _matrix(lenses, f"dist_{name}")
    if distortion is None:
        distortion = _matrix(lenses, f"D_{name}")
    sides = [
        round(side)
        for side in (lenses.get(f"{key}_{name}") for key in "WH")
        if isinstance(side, int | float) and 0 < side < LONGEST_SIDE_PX
    ]
    return View(
        matrix=_needed(where, lenses, f"K_{name}", 9).reshape(3, 3),
        distortion=np.zeros(5) if distortion is None else distortion.ravel(),
        rotation=from_rodrigues(_needed(where, poses, f"R_{name}", 3)),
        translation=_needed(where, poses, f"T_{name}", 3).ravel(),
        size=(sides[0], sides[1]) if len(sides) == 2 else None,
    )


def _needed(where: str, storage: Content, key: str, count: int) -> Array:
    found = _matrix(storage, key)
    if found is None or found.size != count:
        raise BadInputError(f"{where} has no {key} of {count} numbers")
    return found


def _matrix(storage: Content, key: str) -> Array | None:
    found = storage.get(key)
    return found if isinstance(found, np.ndarray) else None


PARAMETERS = "cameraIntrinsicsExtrinsics.pickle"
_ALLOWED = {
    *((f"numpy.{core}.multiarray", "_reconstruct") for core in ("core", "_core")),
    *((f"numpy.{core}.multiarray", "scalar") for core in ("core", "_core")),
    *((f"numpy.{core}.numeric", "_frombuffer") for core in ("core", "_core")),
    ("numpy", "ndarray"),
    ("numpy", "dtype"),
    ("_codecs", "encode"),
}


class _ArraysOnly(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in _ALLOWED:
            raise pickle.UnpicklingError(f"it holds {module}.{name}, which is no array")
        return super().find_class(module, name)


def is_opencap(path: Path) -> bool:
    """Whether a path is such a pickle, or a folder of cameras that have one each."""
    if path.is_dir():
        return any(path.glob(f"*/{PARAMETERS}"))
    return path.suffix in (".pickle", ".pkl")


def read_opencap(paths: Sequence[tuple[str, Path]]) -> Views:
    """Read pickles, each with the camera it is of (or '': that of its folder), or a folder of cameras.

    Raises BadInputError, with the file, for what is broken or not yet calibrated.
    """
    files: dict[str, Path] = {}
    for name, path in paths:
        for file in sorted(path.glob(f"*/{PARAMETERS}")) if path.is_dir() else [path]:
            files[name or file.resolve().parent.name] = file
    return Views({name: _opencap_view(file) for name, file in files.items()}, PARAMETERS, "mm")


def _opencap_view(file: Path) -> View:
    try:
        content = _ArraysOnly(io.BytesIO(file.read_bytes())).load()
    except OSError as error:
        raise BadInputError(f"cannot read {file}: {error.strerror}") from error
    except Exception as error:  # a broken pickle may raise anything
        raise BadInputError(f"cannot read the calibration {file}: {error}") from error
    if not isinstance(content, dict):
        raise BadInputError(f"{file} does not hold OpenCap's camera parameters")
    height, width = _opencap_numbers(file, content, "imageSize", 2)
    return View(
        matrix=_opencap_numbers(file, content, "intrinsicMat", 9).reshape(3, 3),
        distortion=_opencap_numbers(file, content, "distortion", 4, 5),
        rotation=_opencap_numbers(file, content, "rotation", 9).reshape(3, 3),
        translation=_opencap_numbers(file, content, "translation", 3),
        size=(round(width), round(height)),
    )


def _opencap_numbers(file: Path, content: dict[Any, Any], key: str, *counts: int) -> Array:
    try:
        values = np.asarray(content[key], np.float64).ravel()
    except KeyError:
        raise BadInputError(f"{file} has no {key}", hint="is the camera calibrated?") from None
    except (TypeError, ValueError):
        raise BadInputError(f"{file}: {key} is not made of numbers") from None
    if values.size not in counts or not np.isfinite(values).all():
        raise BadInputError(f"{file}: {key} does not have {' or '.join(map(str, counts))} numbers")
    return values


_SUBPIXELS = 64.0
_OPENCV_FROM_QUALISYS = np.diag([1.0, -1.0, -1.0])


def read_qualisys(path: Path) -> Views:
    """Read the cameras of a .qca.txt by their serials. Raises BadInputError, with the camera, if broken."""
    try:
        root = ET.parse(path).getroot()  # noqa: S314 - expat resolves no external entities and limits the rest
    except (OSError, ET.ParseError) as error:
        raise BadInputError(f"cannot read the calibration {path}: {error}") from error
    views = {}
    for number, camera in enumerate(root.iter("camera"), 1):
        label = camera.get("serial") or str(number)
        views[label] = _qualisys_view(f"{path}: camera {label}", camera)
    if not views:
        raise BadInputError(f"{path} has no cameras", hint="is it a Qualisys calibration?")
    return Views(views, path.name, "mm")


def _qualisys_view(where: str, camera: ET.Element) -> View:
    left, top, right, bottom = _qualisys_numbers(where, camera, "fov_video", "left", "top", "right", "bottom")
    fu, fv, cu, cv, skew = _qualisys_numbers(
        where, camera, "intrinsic", "focalLengthU", "focalLengthV", "centerPointU", "centerPointV", "skew"
    )
    radial = _qualisys_numbers(where, camera, "intrinsic", *(f"radialDistortion{n}" for n in (1, 2, 3)))
    tangential = _qualisys_numbers(where, camera, "intrinsic", *(f"tangentalDistortion{n}" for n in (1, 2)))
    axes = _qualisys_numbers(
        where, camera, "transform", *(f"r{row}{column}" for row in "123" for column in "123")
    )
    position = _qualisys_numbers(where, camera, "transform", "x", "y", "z")
    rotation = _OPENCV_FROM_QUALISYS @ axes.reshape(3, 3)
    return View(
        matrix=np.array(
            [
                [fu / _SUBPIXELS, skew / _SUBPIXELS, cu / _SUBPIXELS - left],
                [0.0, fv / _SUBPIXELS, cv / _SUBPIXELS - top],
                [0.0, 0.0, 1.0],
            ]
        ),
        distortion=np.concatenate([radial[:2], tangential, radial[2:]]),
        rotation=rotation,
        translation=-rotation @ position,
        size=(round(right - left) + 1, round(bottom - top) + 1),
    )


def _qualisys_numbers(where: str, camera: ET.Element, tag: str, *keys: str) -> Array:
    element = camera.find(tag)
    if element is None:
        raise BadInputError(f"{where} has no <{tag}>")
    try:
        return np.array([float(element.attrib[key]) for key in keys])
    except KeyError as error:
        raise BadInputError(f"{where}: <{tag}> has no {error.args[0]}") from None
    except ValueError as error:
        raise BadInputError(f"{where}: <{tag}>: {error}") from None
