"""Qualisys's calibrations, .qca.txt.

Its cameras look along -z with y up. `transform` holds the camera's axes as rows (r11 r12 r13 is the camera's
x axis in the room) and its position. Lens values are in 1/64 px, except for OpenCV's distortion.
"""

from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.session.format.lens import Array
from capture_app.session.importing.importer import Importer
from capture_app.session.importing.views import EXPORT_AGAIN, View, Views, numbers, read_xml

_SUBPIXELS = 64.0
_OPENCV_FROM_QUALISYS = np.diag([1.0, -1.0, -1.0])


def read_calibration(paths: Sequence[tuple[str, Path]], cameras: Sequence[str]) -> Views | None:
    """Read the cameras of a .qca.txt by serial. Raises BadInputError, with the camera, if malformed."""
    path = paths[0][1]
    # Metashape's document has an element of this name too.
    if (root := read_xml(path, "calibration")) is None:
        return None
    labelled = {camera.get("serial") or str(n): camera for n, camera in enumerate(root.iter("camera"), 1)}
    views = {label: _view(f"{path}: camera {label}", camera) for label, camera in labelled.items()}
    if not views:
        raise BadInputError(f"{path} has no cameras", hint="give a .qca.txt that Qualisys exported")
    return Views(views, path.name, "mm")


def _view(where: str, camera: ET.Element) -> View:
    if (view_rotation := camera.get("viewrotation", "0")) != "0":
        raise BadInputError(
            f"{where} has its view rotated by {view_rotation} degrees, and its lens as the sensor reads it",
            hint="export the videos without rotation, and the calibration with viewrotation 0",
        )
    left, top, right, bottom = _attributes(where, camera, "fov_video", "left", "top", "right", "bottom")
    fu, fv, cu, cv, skew = (
        _attributes(
            where, camera, "intrinsic", "focalLengthU", "focalLengthV", "centerPointU", "centerPointV", "skew"
        )
        / _SUBPIXELS
    )
    bends = [*(f"radialDistortion{n}" for n in (1, 2)), *(f"tangentalDistortion{n}" for n in (1, 2))]
    axes = _attributes(where, camera, "transform", *(f"r{row}{column}" for row in "123" for column in "123"))
    rotation = _OPENCV_FROM_QUALISYS @ axes.reshape(3, 3)
    return View(
        matrix=np.array([[fu, skew, cu - left], [0.0, fv, cv - top], [0.0, 0.0, 1.0]]),
        distortion=_attributes(where, camera, "intrinsic", *bends, "radialDistortion3"),
        rotation=rotation,
        translation=-rotation @ _attributes(where, camera, "transform", "x", "y", "z"),
        size=(round(right - left) + 1, round(bottom - top) + 1),
    )


def _attributes(where: str, camera: ET.Element, tag: str, *keys: str) -> Array:
    if (element := camera.find(tag)) is None:
        raise BadInputError(f"{where} has no <{tag}>", hint=EXPORT_AGAIN)
    return np.concatenate([numbers(f"{where}: <{tag}>", element.attrib, key, 1) for key in keys])


IMPORTER = Importer(
    program="Qualisys",
    help="a calibration's .qca.txt",
    read_calibration=read_calibration,
    calibration_files=("*.qca.txt",),
)
