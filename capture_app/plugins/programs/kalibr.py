"""Calibrations of ETH's Autonomous Systems Lab: Kalibr's camchain.yaml, and the sensor.yaml of EuRoC.

According to its wiki ("Yaml formats"), `intrinsics` are fu, fv, pu, pv, and `T_cn_cnm1` takes points of the
camera before, by number, to this one, in metres. radtan's four coefficients are OpenCV's k1, k2, p1, p2;
equidistant's are the same as OpenCV's fisheye's. According to EuRoC's page (projects.asl.ethz.ch/datasets),
`T_BS` takes points of the sensor to the body, in metres.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.common.names import natural_order
from capture_app.session.format.lens import Array
from capture_app.session.importing.importer import Importer
from capture_app.session.importing.opencv_storage import read_yaml
from capture_app.session.importing.views import View, Views, camera_of, numbers, pinhole, size_of

_MODELS = {
    "pinhole-radtan": False,
    "pinhole-radial-tangential": False,
    "pinhole-equidistant": True,
    "pinhole-none": False,
}
"""Whether a camera of this model is a fisheye."""
_SENSORS = "cam*/sensor.yaml", "mav0/cam*/sensor.yaml"


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
        pose = numbers(where, camera, "T_cn_cnm1", 16).reshape(4, 4) @ pose if views else pose
        named = camera_of(str(camera.get("rostopic", key)), cameras)
        views[named if named in cameras and named not in views else key] = _view(
            where, camera, "distortion_coeffs", pose[:3, :3], pose[:3, 3]
        )
    return Views(views, path.name, "m") if views else None


def _view(where: str, camera: dict[str, Any], coefficients: str, rotation: Array, translation: Array) -> View:
    """Return a camera, whose distortion stands at the key `coefficients`. Raises BadInputError."""
    if (model := f"{camera['camera_model']}-{camera.get('distortion_model')}") not in _MODELS:
        raise BadInputError(
            f"{where} is of Kalibr's model {model}; {', '.join(_MODELS)} are supported",
            hint="calibrate again: kalibr_calibrate_cameras --models pinhole-radtan (or pinhole-equi)",
        )
    return View(
        matrix=pinhole(*numbers(where, camera, "intrinsics", 4)),
        distortion=numbers(where, {coefficients: [0.0] * 4, **camera}, coefficients, 0, 4, 5),
        rotation=rotation,
        translation=translation,
        size=size_of(where, camera, "resolution"),
        is_fisheye=_MODELS[model],
    )


def read_sensors(paths: Sequence[tuple[str, Path]], cameras: Sequence[str]) -> Views | None:
    """Read EuRoC's sensor.yaml, each with its camera's name (or '' for its folder's), or a folder of cameras.

    Raises BadInputError, with the camera, if it is malformed or has another lens model.
    """
    files = {
        name or file.resolve().parent.name: file
        for name, path in paths
        for file in (
            [file for pattern in _SENSORS for file in sorted(path.glob(pattern))] if path.is_dir() else [path]
        )
    }
    views = {}
    for name, file in files.items():
        if not isinstance((camera := read_yaml(file)).get("T_BS"), dict) or "camera_model" not in camera:
            return None
        pose = numbers(str(file), camera["T_BS"], "data", 16).reshape(4, 4)
        rotation = pose[:3, :3].T
        views[name] = _view(str(file), camera, "distortion_coefficients", rotation, -rotation @ pose[:3, 3])
    return Views(views, "sensor.yaml", "m") if views else None


IMPORTER = Importer(
    program="Kalibr",
    help="camchain.yaml as a calibration",
    read_calibration=read_calibration,
    calibration_files=("*camchain*.yaml",),
)
EUROC = Importer(
    program="EuRoC",
    help="the sensor.yaml of each camera as a calibration",
    read_calibration=read_sensors,
    calibration_files=_SENSORS,
    calibration_per_camera=True,
)
