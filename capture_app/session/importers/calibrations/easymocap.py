"""EasyMocap's calibration: `intri.yml` and `extri.yml` in one folder, in OpenCV's YAML.

Keys and conventions are those of its easymocap/mytools/camera_utils.py (read_camera, write_camera): `names`
lists the cameras; K_NAME and dist_NAME (older: D_NAME) are OpenCV's, R_NAME a Rodrigues vector and T_NAME
the translation of x_cam = R x_world + T, H_NAME and W_NAME the images' size where it was known.
"""

from pathlib import Path
from typing import Any

import numpy as np

from capture_app.errors import BadInputError
from capture_app.session.importers.calibrations.camera_views import Array, View, Views, from_rodrigues
from capture_app.session.importers.calibrations.opencv_storage import read_storage

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
    views = {name: _view(folder, name, lenses, poses) for name in names}
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


def _view(folder: Path, name: str, lenses: Content, poses: Content) -> View:
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
