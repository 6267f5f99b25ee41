"""The .dat files of handpose3d and bodypose3d, and of the calibration program of their author.

According to utils.py of github.com/TemugeB/handpose3d, `c0.dat` has OpenCV's matrix and distortion of camera
0, and `rot_trans_c0.dat` R and T, x_cam = R x + T, of which the first are read. Its films are cam0_*.mp4.
python_stereo_camera_calibrate calls them `camera0_intrinsics.dat` and `camera0_rot_trans.dat`. Lengths are
in the unit of the board's square, which its settings state in cm.
"""

import re
from collections.abc import Sequence
from pathlib import Path

from capture_app.session.files.untrusted_files import read_text
from capture_app.session.importing.importer import Importer
from capture_app.session.importing.recording_sources import numbers_in
from capture_app.session.importing.views import View, Views, numbers, rotation_of

MAX_BYTES = 1 << 14
"""Maximum size of a file, bytes."""
_FILE = re.compile(r"(?:rot_trans_)?c(\d+)|camera(\d+)_(?:intrinsics|rot_trans)")
_TABLE = re.compile(r"^(\w+):\s+([-+\d.][-+\d.eE\s]*)$", re.MULTILINE)
_KEYS = {"intrinsic": (9,), "distortion": (4, 5), "R": (9,), "T": (3,)}


def read_calibration(paths: Sequence[tuple[str, Path]], cameras: Sequence[str]) -> Views | None:
    """Read a folder of .dat files, or the folder of one of them. A camera's number is the first in its name.

    Raises BadInputError, with the camera and what it lacks, if a file is missing or malformed.
    """
    path = paths[0][1]
    folder = path if path.is_dir() else path.parent
    tables = dict[int, dict[str, list[str]]]()
    for file in sorted(folder.glob("*.dat")) if path.is_dir() or path.suffix == ".dat" else ():
        if match := _FILE.fullmatch(file.stem):
            own = tables.setdefault(int(match[1] or match[2]), {})
            for key, values in _TABLE.findall(read_text(file, max_bytes=MAX_BYTES)):
                own.setdefault(key, values.split())
    views = {}
    for n, own in tables.items():
        name = next((name for name in cameras if numbers_in(name)[:1] == (n,)), f"c{n}")
        matrix, distortion, rotation, translation = (
            numbers(f"{folder}: camera {n}", own, key, *sizes) for key, sizes in _KEYS.items()
        )
        views[name] = View(matrix.reshape(3, 3), distortion, rotation_of(rotation), translation)
    return Views(views, folder.name, assumed_unit="cm") if views else None


IMPORTER = Importer(
    program="handpose3d",
    help="camera_parameters with c0.dat, rot_trans_c0.dat of each camera as a calibration",
    read_calibration=read_calibration,
    calibration_files=("rot_trans_c*.dat", "camera*_rot_trans.dat"),
    calibration_per_camera=True,
)
