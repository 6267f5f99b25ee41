"""EasyMocap: a sequence with its calibration, intri.yml and extri.yml.

Keys and conventions follow its easymocap/mytools/camera_utils.py (read_camera, write_camera): `names` lists
the cameras; K_NAME and dist_NAME (older: D_NAME) are OpenCV's, R_NAME is a Rodrigues vector and T_NAME the
translation of x_cam = R x_world + T; H_NAME and W_NAME are the image size if it was known.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.session.importing.importer import Importer, open_images, open_sources
from capture_app.session.importing.opencv_storage import read_storage
from capture_app.session.importing.recording_sources import Layout, images_in
from capture_app.session.importing.views import View, Views, numbers, rotation_of

INTRINSICS, EXTRINSICS = "intri.yml", "extri.yml"
_LONGEST_SIDE_PX = 1e6


def open_recording(path: Path, *, png: bool, recording: str | None) -> Layout | None:
    """Open a sequence with its calibration; EasyMocap treats frames of equal number as one instant."""
    if not all((path / name).is_file() for name in (INTRINSICS, EXTRINSICS)):
        return None
    place = next((path / name for name in ("videos", "images") if (path / name).is_dir()), path)
    # One image a camera, as where a rig is tried, has no folder.
    alone = {image.stem for image in images_in(place)}
    views = read_calibration([("", path)], ()) if alone else None
    is_one_instant = views is not None and alone <= views.cameras.keys()
    return Layout(
        path=place,
        sources=tuple(open_images(place) if is_one_instant else open_sources([str(place)], png=png)),
        same_frames=True,
        calibration=path,
    )


def read_calibration(paths: Sequence[tuple[str, Path]], cameras: Sequence[str]) -> Views | None:
    """Read intri.yml and extri.yml, given their folder or one of them. Raises BadInputError."""
    files = (EXTRINSICS, INTRINSICS)
    path = paths[0][1]
    folder = path if path.is_dir() else path.parent
    missing = [name for name in files if not (folder / name).is_file()]
    if len(missing) == len(files) or not (path.is_dir() or path.name in files):
        return None
    if missing:
        raise BadInputError(
            f"no {missing[0]} in {folder}", hint=f"EasyMocap needs both: {INTRINSICS}, {EXTRINSICS}"
        )
    content = read_storage(folder / EXTRINSICS) | read_storage(folder / INTRINSICS)
    listed = content["names"] if isinstance(content.get("names"), list) else ()
    labels = [f"{label:g}" if isinstance(label, int | float) else str(label) for label in listed]
    labels = [label for label in labels if label not in ("", "none")]
    if not labels:
        raise BadInputError(
            f"{folder / INTRINSICS} has no list of cameras, names",
            hint="give the intri.yml and extri.yml that EasyMocap wrote",
        )
    return Views({name: _view(folder, name, content) for name in labels}, f"{INTRINSICS}, {EXTRINSICS}")


def _view(folder: Path, name: str, content: dict[str, Any]) -> View:
    where = f"{folder}: camera {name}"
    given = (content.get(f"{key}_{name}") for key in ("dist", "D"))
    distortion = next((matrix.ravel() for matrix in given if isinstance(matrix, np.ndarray)), np.zeros(5))
    size = [
        round(side)
        for side in (content.get(f"{key}_{name}") for key in "WH")
        if isinstance(side, int | float) and 0 < side < _LONGEST_SIDE_PX
    ]
    return View(
        matrix=numbers(where, content, f"K_{name}", 9).reshape(3, 3),
        distortion=distortion,
        rotation=rotation_of(numbers(where, content, f"R_{name}", 3)),
        translation=numbers(where, content, f"T_{name}", 3),
        size=(size[0], size[1]) if len(size) == 2 else None,
    )


IMPORTER = Importer(
    program="EasyMocap",
    help="a sequence's videos or images with intri.yml and extri.yml; these as a calibration",
    open_recording=open_recording,
    read_calibration=read_calibration,
    calibration_files=(INTRINSICS, EXTRINSICS),
    calibration_per_camera=True,
    priority=-1,
)
