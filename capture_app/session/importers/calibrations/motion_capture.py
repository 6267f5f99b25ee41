"""Calibrations of motion capture programs: Caliscope and Anipose, EasyMocap, OpenCap, Qualisys.

EasyMocap's keys and conventions are those of its easymocap/mytools/camera_utils.py (read_camera,
write_camera): `names` lists the cameras; K_NAME and dist_NAME (older: D_NAME) are OpenCV's, R_NAME a
Rodrigues vector and T_NAME the translation of x_cam = R x_world + T, H_NAME and W_NAME the images' size where
it was known. OpenCap's are those of opencap-core's utilsChecker.py: imageSize is (height, width), the board's
squares are in mm. A pickle can hold anything, also programs: arrays and numbers are taken, all else is
refused. Qualisys's cameras look along -z with y up, and `transform` holds the camera's axes as rows (r11 r12
r13 is the camera's x axis in the room) and its position. Pixels are in 64ths; the distortion, OpenCV's, is
not.
"""

import io
import pickle
import tomllib
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.session.files.strangers import read_text
from capture_app.session.importers.calibrations.opencv import read_storage
from capture_app.session.importers.calibrations.views import Array, View, Views, numbers, rotation_of


def read_caliscope(path: Path) -> Views:
    """Read the cameras of a Caliscope or Anipose TOML; a rotation is a matrix or a Rodrigues vector.

    Raises BadInputError, with the camera, for what is broken or not yet calibrated.
    """
    try:
        content = tomllib.loads(read_text(path))
    except tomllib.TOMLDecodeError as error:
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
        where = f"{path}: camera {label}"
        width, height = numbers(where, table, "size", 2)
        views[label] = View(
            matrix=numbers(where, table, "matrix", 9).reshape(3, 3),
            distortion=numbers(where, table, "distortions", 4, 5, 8),
            rotation=rotation_of(where, numbers(where, table, "rotation", 3, 9)),
            translation=numbers(where, table, "translation", 3),
            size=(int(width), int(height)),
        )
    return Views(views, path.name)


INTRINSICS, EXTRINSICS = "intri.yml", "extri.yml"
LONGEST_SIDE_PX = 1e6


def is_easymocap(path: Path) -> bool:
    """Whether a path is a folder with both files, or one of them."""
    folder = path if path.is_dir() else path.parent
    named = path.is_dir() or path.name in (INTRINSICS, EXTRINSICS)
    return named and any((folder / name).is_file() for name in (INTRINSICS, EXTRINSICS))


def read_easymocap(path: Path) -> Views:
    """Read both files of a folder, or of the folder of one of them. Raises BadInputError for what lacks."""
    folder = path if path.is_dir() else path.parent
    content: dict[str, Any] = {}
    for name in (EXTRINSICS, INTRINSICS):
        if not (folder / name).is_file():
            raise BadInputError(
                f"no {name} in {folder}", hint=f"EasyMocap needs both: {INTRINSICS}, {EXTRINSICS}"
            )
        content |= read_storage(folder / name)
    listed = content.get("names") if isinstance(content.get("names"), list) else ()
    labels = [f"{one:g}" if isinstance(one, int | float) else str(one) for one in listed or ()]
    labels = [label for label in labels if label not in ("", "none")]
    if not labels:
        raise BadInputError(f"{folder / INTRINSICS} has no list of cameras, names", hint="is it EasyMocap's?")
    return Views(
        {name: _easymocap_view(folder, name, content) for name in labels}, f"{INTRINSICS}, {EXTRINSICS}"
    )


def _easymocap_view(folder: Path, name: str, content: dict[str, Any]) -> View:
    where = f"{folder}: camera {name}"
    given = (content.get(f"{key}_{name}") for key in ("dist", "D"))
    distortion = next((one.ravel() for one in given if isinstance(one, np.ndarray)), np.zeros(5))
    sides = [
        round(side)
        for side in (content.get(f"{key}_{name}") for key in "WH")
        if isinstance(side, int | float) and 0 < side < LONGEST_SIDE_PX
    ]
    return View(
        matrix=numbers(where, content, f"K_{name}", 9).reshape(3, 3),
        distortion=distortion,
        rotation=rotation_of(where, numbers(where, content, f"R_{name}", 3)),
        translation=numbers(where, content, f"T_{name}", 3),
        size=(sides[0], sides[1]) if len(sides) == 2 else None,
    )


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
    return any(path.glob(f"*/{PARAMETERS}")) if path.is_dir() else path.suffix in (".pickle", ".pkl")


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
    where = str(file)
    size = numbers(where, content, "imageSize", 2)
    return View(
        matrix=numbers(where, content, "intrinsicMat", 9).reshape(3, 3),
        distortion=numbers(where, content, "distortion", 4, 5),
        rotation=numbers(where, content, "rotation", 9).reshape(3, 3),
        translation=numbers(where, content, "translation", 3),
        size=(round(size[1]), round(size[0])),
    )


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
    left, top, right, bottom = _attributes(where, camera, "fov_video", "left", "top", "right", "bottom")
    fu, fv, cu, cv, skew = (
        _attributes(
            where, camera, "intrinsic", "focalLengthU", "focalLengthV", "centerPointU", "centerPointV", "skew"
        )
        / _SUBPIXELS
    )
    bends = [*(f"radialDistortion{n}" for n in (1, 2)), *(f"tangentalDistortion{n}" for n in (1, 2))]
    axes = _attributes(where, camera, "transform", *(f"r{row}{column}" for row in "123" for column in "123"))
    rotation = _OPENCV_FROM_QUALISYS @ axes.reshape(3, 3)
    return View(
        matrix=np.array([[fu, skew, cu - left], [0.0, fv, cv - top], [0.0, 0.0, 1.0]]),
        distortion=_attributes(where, camera, "intrinsic", *bends, "radialDistortion3"),
        rotation=rotation,
        translation=-rotation @ _attributes(where, camera, "transform", "x", "y", "z"),
        size=(round(right - left) + 1, round(bottom - top) + 1),
    )


def _attributes(where: str, camera: ET.Element, tag: str, *keys: str) -> Array:
    element = camera.find(tag)
    if element is None:
        raise BadInputError(f"{where} has no <{tag}>")
    try:
        return np.array([float(element.attrib[key]) for key in keys])
    except KeyError as error:
        raise BadInputError(f"{where}: <{tag}> has no {error.args[0]}") from None
    except ValueError as error:
        raise BadInputError(f"{where}: <{tag}>: {error}") from None
