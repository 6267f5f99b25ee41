"""Qualisys Track Manager's calibration (.qca.txt, XML): lengths in mm, pixels in 64ths.

Its cameras look along -z with y up, and `transform` holds the camera's axes as rows (r11 r12 r13 is the
camera's x axis in the room) and its position. The distortion is OpenCV's, in units of the focal length:
of all numbers it alone is not in 64ths.
"""

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from capture_app.errors import BadInputError
from capture_app.session.importers.calibrations.camera_views import Array, View, Views

_SUBPIXELS = 64.0
_OPENCV_FROM_QUALISYS = np.diag([1.0, -1.0, -1.0])


def read_qualisys(path: Path) -> Views:
    """Read the cameras of a .qca.txt by their serials. Raises BadInputError, with the camera, if broken."""
    try:
        root = ET.parse(path).getroot()  # noqa: S314 - expat resolves no external entities and limits the rest
    except (OSError, ET.ParseError) as error:
        raise BadInputError(f"cannot read the calibration {path}: {error}") from error
    views = {}
    for number, camera in enumerate(root.iter("camera"), 1):
        label = camera.get("serial") or str(number)
        views[label] = _view(f"{path}: camera {label}", camera)
    if not views:
        raise BadInputError(f"{path} has no cameras", hint="is it a Qualisys calibration?")
    return Views(views, path.name, "mm")


def _view(where: str, camera: ET.Element) -> View:
    left, top, right, bottom = _numbers(where, camera, "fov_video", "left", "top", "right", "bottom")
    fu, fv, cu, cv, skew = _numbers(
        where, camera, "intrinsic", "focalLengthU", "focalLengthV", "centerPointU", "centerPointV", "skew"
    )
    radial = _numbers(where, camera, "intrinsic", *(f"radialDistortion{n}" for n in (1, 2, 3)))
    tangential = _numbers(where, camera, "intrinsic", *(f"tangentalDistortion{n}" for n in (1, 2)))
    axes = _numbers(where, camera, "transform", *(f"r{row}{column}" for row in "123" for column in "123"))
    position = _numbers(where, camera, "transform", "x", "y", "z")
    rotation = _OPENCV_FROM_QUALISYS @ axes.reshape(3, 3)
    return View(
        matrix=np.array(
            [
                [fu / _SUBPIXELS, skew / _SUBPIXELS, cu / _SUBPIXELS - left],
                [0.0, fv / _SUBPIXELS, cv / _SUBPIXELS - top],
                [0.0, 0.0, 1.0],
            ]
        ),
        distortion=np.concatenate([radial[:2], tangential, radial[2:]]),
        rotation=rotation,
        translation=-rotation @ position,
        size=(round(right - left) + 1, round(bottom - top) + 1),
    )


def _numbers(where: str, camera: ET.Element, tag: str, *keys: str) -> Array:
    element = camera.find(tag)
    if element is None:
        raise BadInputError(f"{where} has no <{tag}>")
    try:
        return np.array([float(element.attrib[key]) for key in keys])
    except KeyError as error:
        raise BadInputError(f"{where}: <{tag}> has no {error.args[0]}") from None
    except ValueError as error:
        raise BadInputError(f"{where}: <{tag}>: {error}") from None
