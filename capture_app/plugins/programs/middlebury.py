"""Middlebury's calib.txt of a rectified pair, as a calibration.

According to vision.middlebury.edu/stereo/data/scenes2014, `cam0` and `cam1` are the camera matrices
`[f 0 cx0; 0 f cy; 0 0 1]`, `baseline` is in mm and depth is baseline * f / (disparity + doffs), with doffs =
cx1 - cx0. ETH3D's two-view scenes have the same file.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.session.files.untrusted_files import read_text
from capture_app.session.importing.importer import Importer
from capture_app.session.importing.views import View, Views, numbers

MAX_OFFSET_ERROR_PX = 0.1
"""Maximum difference of `doffs` from the principal points' distance: both are rounded."""
_HINT = "give the calib.txt of the scene as it was downloaded"


def read_calibration(paths: Sequence[tuple[str, Path]], cameras: Sequence[str]) -> Views | None:
    """Read a calib.txt; of two cameras the first is the left one, cam0.

    Raises BadInputError, with the key, if it is malformed.
    """
    path = paths[0][1]
    text = "" if path.suffix.lower() != ".txt" or path.is_dir() else read_text(path, encoding="latin-1")
    if not re.search(r"(?m)^cam0\s*=\s*\[", text):
        return None
    content = {
        key: re.split(r"[;\s]+", value.strip())
        for key, value in re.findall(r"(\w+)\s*=\s*\[?([^]\r\n]+)", text)
    }
    width, height, baseline = (
        float(numbers(str(path), content, key, 1, hint=_HINT)[0]) for key in ("width", "height", "baseline")
    )
    views = {
        label: View(
            matrix=numbers(str(path), content, f"cam{n}", 9, hint=_HINT).reshape(3, 3),
            distortion=np.zeros(5),
            rotation=np.eye(3),
            translation=np.array([-n * baseline, 0.0, 0.0]),
            size=(round(width), round(height)),
        )
        for n, label in enumerate(cameras if len(cameras) == 2 else ("cam0", "cam1"))
    }
    _check_disparity(str(path), content, [view.matrix[0, 2] for view in views.values()])
    return Views(views, path.name, "mm")


def _check_disparity(where: str, content: Mapping[str, list[str]], middles: Sequence[float]) -> None:
    """Raise BadInputError if disparities are not offset by the difference of principal points."""
    if "doffs" not in content:
        return
    offset = float(numbers(where, content, "doffs", 1, hint=_HINT)[0])
    if abs(offset - (middles[1] - middles[0])) > MAX_OFFSET_ERROR_PX:
        raise BadInputError(
            f"{where}: doffs is {offset:g}, but cx of cam1 and cam0 differ by {middles[1] - middles[0]:g}",
            hint=_HINT,
        )


IMPORTER = Importer(
    program="Middlebury",
    help="the calib.txt of a rectified pair as a calibration",
    read_calibration=read_calibration,
    calibration_files=("calib.txt",),
)
