"""CMU Panoptic's calibration_SEQUENCE.json.

According to panoptic-toolbox (README.md, python/panutils.py projectPoints), `K`, `distCoef`, `R` and `t` are
OpenCV's, x_cam = R x + t. The lengths are cm. Camera 00_01 of type hd has the video hd_00_01.mp4, or the
folder 00_01 of images.
"""

from collections.abc import Sequence
from pathlib import Path

from capture_app.session.importing.importer import Importer
from capture_app.session.importing.views import View, Views, numbers, read_json, size_of


def read_calibration(paths: Sequence[tuple[str, Path]], cameras: Sequence[str]) -> Views | None:
    """Read a recording's cameras out of the studio's; all, if it has none of them.

    Raises BadInputError, with the camera, if it is malformed.
    """
    path = paths[0][1]
    content = read_json(path)
    listed = content.get("cameras") if isinstance(content, dict) and "calibDataSource" in content else None
    views = {}
    for camera in (entry for entry in listed if isinstance(entry, dict)) if isinstance(listed, list) else ():
        name = str(camera.get("name"))
        film, where = f"{camera.get('type')}_{name}", f"{path}: camera {name}"
        views[film if film in cameras else name] = View(
            matrix=numbers(where, camera, "K", 9).reshape(3, 3),
            distortion=numbers(where, camera, "distCoef", 5),
            rotation=numbers(where, camera, "R", 9).reshape(3, 3),
            translation=numbers(where, camera, "t", 3),
            size=size_of(where, camera, "resolution"),
        )
    used = {name: view for name, view in views.items() if name in cameras}
    return Views(used or views, path.name, "cm") if views else None


IMPORTER = Importer(
    program="CMU Panoptic",
    help="calibration_SEQUENCE.json as a calibration",
    read_calibration=read_calibration,
    calibration_files=("calibration_*.json",),
)
