"""ROS's CameraInfo: lenses of its messages, and of the files that camera_calibration writes.

According to sensor_msgs/CameraInfo, R turns the camera's axes to the rectified ones, which a stereo pair
shares, and P's fourth column is the first camera's position in the second one's, times its focal length;
lengths are in metres.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.session.format.lens import Array
from capture_app.session.importing.importer import Importer
from capture_app.session.importing.opencv_storage import read_yaml
from capture_app.session.importing.views import EXPORT_AGAIN, View, Views, number, numbers

_MODELS = {"": False, "plumb_bob": False, "rational_polynomial": False, "equidistant": True}
"""Whether a lens of this model, with OpenCV's coefficients, is a fisheye."""
_KEYS = {
    "camera_matrix": "K",
    "distortion_coefficients": "D",
    "rectification_matrix": "R",
    "projection_matrix": "P",
    "image_width": "WIDTH",
    "image_height": "HEIGHT",
}
"""The message's fields by their names in a file."""


def view_of_info(
    where: str, info: Mapping[str, Any], rotation: Array, translation: Array, hint: str = EXPORT_AGAIN
) -> View:
    """Return a view by K, D, WIDTH, HEIGHT and distortion_model. Raises BadInputError for other models."""
    if (model := str(info.get("distortion_model", ""))) not in _MODELS:
        raise BadInputError(
            f"{where} has a lens of model {model}, not {', '.join(filter(None, _MODELS))}", hint=hint
        )
    distortion = numbers(where, {"D": (), **info}, "D", 0, 4, 5, 8, 12, 14, hint=hint)
    if distortion[5:].any():
        raise BadInputError(
            f"{where} has a lens of more terms than k1, k2, p1, p2, k3",
            hint="calibrate again with camera_calibration's -k 3",
        )
    return View(
        matrix=numbers(where, info, "K", 9, hint=hint).reshape(3, 3),
        distortion=distortion,
        rotation=rotation,
        translation=translation,
        size=(round(number(where, info, "WIDTH")), round(number(where, info, "HEIGHT"))),
        is_fisheye=_MODELS[model],
    )


def read_calibration(paths: Sequence[tuple[str, Path]], cameras: Sequence[str]) -> Views | None:
    """Read files, each with its camera's name (or '' for the file's), or a folder of them.

    Raises BadInputError, with the file, if it is malformed or if the cameras were calibrated one by one.
    """
    files = [
        (name, file)
        for name, path in paths
        for file in (sorted(path.glob("*.y*ml")) if path.is_dir() else [path])
    ]
    views: dict[str, View] = {}
    for name, file in files:
        info = {
            _KEYS.get(key, key.upper() if len(key) < 7 else key): value.get("data")
            if isinstance(value, dict)
            else value
            for key, value in read_yaml(file).items()
        }
        if "distortion_model" in info and isinstance(info.get("K"), list):
            rotation = numbers(str(file), info, "R", 9).reshape(3, 3).T
            lens, offset = np.split(numbers(str(file), info, "P", 12).reshape(3, 4), [3], axis=1)
            if lens[np.tril_indices(3, -1)].any():
                raise BadInputError(f"{file} has a P that is not of rectified images", hint=EXPORT_AGAIN)
            place = np.linalg.lstsq(lens, offset.ravel())[0]
            views[name or file.stem] = view_of_info(str(file), info, rotation, rotation @ place)
    if len(views) > 1 and not any(view.translation.any() for view in views.values()):
        raise BadInputError(
            f"{' and '.join(views)} were calibrated one by one: no P has a baseline",
            hint="calibrate them as a pair there; or import without --calibration, then: "
            "reconstruct calibrate SESSION",
        )
    return Views(views, ", ".join(file.name for _, file in files), "m") if views else None


IMPORTER = Importer(
    program="ROS camera_info",
    help="the .yaml of each camera of a stereo pair as a calibration",
    read_calibration=read_calibration,
    calibration_per_camera=True,
    priority=-3,
)
