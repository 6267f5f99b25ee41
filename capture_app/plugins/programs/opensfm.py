"""OpenSfM's reconstruction.json, which OpenDroneMap writes too, as a calibration.

According to opensfm.org ("Geometric Models"), lenses are in units of the image's longer side from its
middle, the first pixel's centre is (0, 0), and a shot's rotation (angle-axis) and translation are x_cam = R
x_world + t. The world is in metres only if the images have GPS.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.session.format.calibration import TERMS
from capture_app.session.importing.importer import Importer
from capture_app.session.importing.views import (
    EXPORT_AGAIN,
    View,
    Views,
    camera_of,
    number,
    numbers,
    pinhole,
    read_json,
    rotation_of,
    views_of_images,
)

_PERSPECTIVE = ("perspective", "simple_radial", "radial", "brown")
_FISHEYES = ("fisheye", "fisheye_opencv")


class _Reconstruction(msgspec.Struct):
    cameras: dict[str, dict[str, Any]]
    shots: dict[str, dict[str, Any]]


def read_calibration(paths: Sequence[tuple[str, Path]], cameras: Sequence[str]) -> Views | None:
    """Read the cameras of a reconstruction; an image's path names its camera.

    Raises BadInputError, with the image, if it is malformed, for other lens models, and if cameras move.
    """
    path = paths[0][1]
    try:
        parts = msgspec.convert(read_json(path), list[_Reconstruction])
    except msgspec.ValidationError:
        return None
    if len(parts) > 1:
        raise BadInputError(
            f"{path} has {len(parts)} reconstructions without common coordinates",
            hint="delete all but the recording's from the file",
        )
    if not parts:
        return None
    shots = [
        (camera_of(image, cameras), _view(f"{path}: {image}", shot, parts[0].cameras))
        for image, shot in parts[0].shots.items()
    ]
    views = views_of_images(str(path), shots, "a rig stands still: give the reconstruction of one instant")
    return Views(views, path.name, assumed_unit="arbitrary")


def _view(where: str, shot: dict[str, Any], lenses: dict[str, Any]) -> View:
    lens = lenses.get(str(shot.get("camera")), {})
    if (model := lens.get("projection_type")) not in (*_PERSPECTIVE, *_FISHEYES):
        raise BadInputError(
            f"{where} is of a camera of type {model}; {', '.join((*_PERSPECTIVE, *_FISHEYES))} are supported",
            hint="reconstruct with one of these in camera_models_overrides.json",
        )
    size = (round(number(where, lens, "width")), round(number(where, lens, "height")))
    if min(size) < 1:
        raise BadInputError(f"{where} is of images of {size[0]}x{size[1]} pixels", hint=EXPORT_AGAIN)
    fx = number(where, lens, "focal" if "focal" in lens else "focal_x")
    across, down = ((side - 1) / 2 / max(size) for side in size)
    cx, cy = number(where, lens, "c_x", 0.0) + across, number(where, lens, "c_y", 0.0) + down
    return View(
        matrix=pinhole(*(max(size) * focal for focal in (fx, number(where, lens, "focal_y", fx), cx, cy))),
        distortion=np.array([number(where, lens, key, 0.0) for key in TERMS[model in _FISHEYES]]),
        rotation=rotation_of(numbers(where, shot, "rotation", 3)),
        translation=numbers(where, shot, "translation", 3),
        size=size,
        is_fisheye=model in _FISHEYES,
    )


IMPORTER = Importer(
    program="OpenSfM, OpenDroneMap",
    help="reconstruction.json as a calibration",
    read_calibration=read_calibration,
    calibration_files=("reconstruction.json",),
)
