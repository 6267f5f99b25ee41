"""Kalibr's camchain.yaml, as a calibration.

According to its wiki ("Yaml formats"), `intrinsics` are fu, fv, pu, pv, and `T_cn_cnm1` takes points of the
camera before, by number, to this one, in metres. radtan's four coefficients are OpenCV's k1, k2, p1, p2;
equidistant's are those of OpenCV's fisheye.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.common.names import natural_order
from capture_app.session.importing.importer import Importer
from capture_app.session.importing.opencv_storage import read_yaml
from capture_app.session.importing.views import View, Views, camera_of, numbers, pinhole

_MODELS = {"pinhole-radtan": False, "pinhole-equidistant": True, "pinhole-none": False}
"""Whether a camera of this model is a fisheye."""


def read_calibration(paths: Sequence[tuple[str, Path]], cameras: Sequence[str]) -> Views | None:
    """Read a camchain; the topic of a camera names it, otherwise its key (cam0).

    Raises BadInputError, with the camera, if it is malformed or has another lens model.
    """
    path = paths[0][1]
    views: dict[str, View] = {}
    chain = {
        key: camera
        for key, camera in read_yaml(path).items()
        if isinstance(camera, dict) and "camera_model" in camera
    }
    pose = np.eye(4)
    for key in sorted(chain, key=natural_order):
        camera, where = chain[key], f"{path}: {key}"
        if (model := f"{camera['camera_model']}-{camera.get('distortion_model')}") not in _MODELS:
            raise BadInputError(
                f"{where} is of Kalibr's model {model}; {', '.join(_MODELS)} are supported",
                hint="calibrate again: kalibr_calibrate_cameras --models pinhole-radtan (or pinhole-equi)",
            )
        pose = numbers(where, camera, "T_cn_cnm1", 16).reshape(4, 4) @ pose if views else pose
        width, height = numbers(where, camera, "resolution", 2)
        named = camera_of(str(camera.get("rostopic", key)), cameras)
        views[named if named in cameras and named not in views else key] = View(
            matrix=pinhole(*numbers(where, camera, "intrinsics", 4)),
            distortion=numbers(where, {"distortion_coeffs": [0.0] * 4, **camera}, "distortion_coeffs", 0, 4),
            rotation=pose[:3, :3],
            translation=pose[:3, 3],
            size=(round(width), round(height)),
            is_fisheye=_MODELS[model],
        )
    return Views(views, path.name, "m") if views else None


IMPORTER = Importer(
    program="Kalibr",
    help="camchain.yaml as a calibration",
    read_calibration=read_calibration,
    calibration_files=("*camchain*.yaml",),
)
