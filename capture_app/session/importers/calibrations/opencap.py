"""OpenCap's `Videos/CamN/cameraIntrinsicsExtrinsics.pickle`: a camera each, lengths in mm.

By opencap-core's utilsChecker.py: intrinsicMat 3x3, distortion (1, 5), imageSize (height, width), rotation
3x3 and translation of x_cam = R x_board + t, the board's squares in mm. A pickle can hold anything, also
programs: arrays and numbers are taken, all else is refused.
"""

import io
import pickle
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from capture_app.errors import BadInputError
from capture_app.session.importers.calibrations.camera_views import Array, View, Views

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
    return Views({name: _view(file) for name, file in files.items()}, PARAMETERS, "mm")


def _view(file: Path) -> View:
    try:
        content = _ArraysOnly(io.BytesIO(file.read_bytes())).load()
    except OSError as error:
        raise BadInputError(f"cannot read {file}: {error.strerror}") from error
    except Exception as error:  # a broken pickle may raise anything
        raise BadInputError(f"cannot read the calibration {file}: {error}") from error
    if not isinstance(content, dict):
        raise BadInputError(f"{file} does not hold OpenCap's camera parameters")
    height, width = _numbers(file, content, "imageSize", 2)
    return View(
        matrix=_numbers(file, content, "intrinsicMat", 9).reshape(3, 3),
        distortion=_numbers(file, content, "distortion", 4, 5),
        rotation=_numbers(file, content, "rotation", 9).reshape(3, 3),
        translation=_numbers(file, content, "translation", 3),
        size=(round(width), round(height)),
    )


def _numbers(file: Path, content: dict[Any, Any], key: str, *counts: int) -> Array:
    try:
        values = np.asarray(content[key], np.float64).ravel()
    except KeyError:
        raise BadInputError(f"{file} has no {key}", hint="is the camera calibrated?") from None
    except (TypeError, ValueError):
        raise BadInputError(f"{file}: {key} is not made of numbers") from None
    if values.size not in counts or not np.isfinite(values).all():
        raise BadInputError(f"{file}: {key} does not have {' or '.join(map(str, counts))} numbers")
    return values
