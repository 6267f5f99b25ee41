"""KITTI's calibrations: calib_cam_to_cam.txt of its raw drives, calib.txt of its odometry, KITTI-360's.

According to Geiger et al. 2013, "Vision meets Robotics: The KITTI Dataset", in metres: P_rect_0i (odometry:
Pi) takes points of the rectified frame of camera 0 to the pixels of rectified camera i, and R_rect_00 takes
points of camera 0 to that frame. Before rectification, K_0i, D_0i, R_0i and T_0i are OpenCV's lens and x_i =
R x_0 + T. S_0i and S_rect_0i are the sizes of both images.
"""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from capture_app.session.files.untrusted_files import read_text
from capture_app.session.importing.importer import Importer
from capture_app.session.importing.views import View, Views, numbers, size_of

MAX_LETTERS = 1 << 16
"""Maximum number of letters that are read of a file; a calibration has 5,000."""


def read_calibration(paths: Sequence[tuple[str, Path]], cameras: Sequence[str]) -> Views | None:
    """Read a calibration of image_00 to image_03, or image_0 to image_3 (odometry).

    The images' size says whether they are rectified. Raises BadInputError, with the key, if it is malformed.
    """
    path = paths[0][1]
    text = "" if path.suffix.lower() != ".txt" or path.is_dir() else read_text(path, encoding="latin-1")
    content = {
        key: values.split() for key, values in re.findall(r"(?m)^(\w+):[ \t]*(\S.*)$", text[:MAX_LETTERS])
    }
    where, keys = str(path), [key for key in content if re.fullmatch(r"P(_rect_0)?\d", key)]
    views = {}
    for key in keys:
        camera, matrix, is_raw = key[-1], numbers(where, content, key, 12).reshape(3, 4), "_rect_" in key
        unrectified = (
            View(
                matrix=numbers(where, content, f"K_0{camera}", 9).reshape(3, 3),
                distortion=numbers(where, content, f"D_0{camera}", 5),
                rotation=numbers(where, content, f"R_0{camera}", 9).reshape(3, 3),
                translation=numbers(where, content, f"T_0{camera}", 3),
                size=size_of(where, content, f"S_0{camera}"),
            )
            if is_raw
            else None
        )
        views[f"image_0{camera}" if is_raw else f"image_{camera}"] = View(
            matrix=matrix[:, :3],
            distortion=np.zeros(5),
            rotation=numbers(where, {"R_rect_00": np.eye(3)} | content, "R_rect_00", 9).reshape(3, 3),
            translation=np.linalg.pinv(matrix[:, :3]) @ matrix[:, 3],
            size=size_of(where, content, f"S_rect_0{camera}") if is_raw else None,
            unrectified=unrectified,
        )
    return Views(views, path.name, "m") if views else None


IMPORTER = Importer(
    program="KITTI",
    help="calib_cam_to_cam.txt in or above a raw drive, calib.txt or perspective.txt, as a calibration",
    read_calibration=read_calibration,
    # Its archives unpack a drive and its calibration into one folder, or each into its own.
    calibration_files=(
        *("calib_cam_to_cam.txt", "../calib_cam_to_cam.txt", "*/calib_cam_to_cam.txt"),
        *("calib.txt", "perspective.txt"),
    ),
)
