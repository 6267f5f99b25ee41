"""Metashape's cameras.xml ("Export Cameras", Agisoft XML), as a calibration.

According to its manual ("Camera models"), u = w/2 + cx + x'(f + b1) + y' b2 and v = h/2 + cy + y' f, where
the first pixel's centre is (0.5, 0.5). p1 is OpenCV's p2, and p2 its p1. A camera's `transform` takes its
points to the chunk's; its x is right, y down, z forward. The chunk's or the component's `scale` makes
metres of the chunk's lengths.
"""

from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.common.text import count
from capture_app.session.importing.importer import Importer
from capture_app.session.importing.views import (
    EXPORT_AGAIN,
    View,
    Views,
    camera_of,
    number,
    numbers,
    read_xml,
    views_of_images,
)

_READ = {
    "frame": ("k1", "k2", "p2", "p1", "k3"),
    "fisheye": ("k1", "k2", "k3", "k4"),
    "equidistant_fisheye": ("k1", "k2", "k3", "k4"),
}
"""The coefficients of each sensor type, in the order of OpenCV's perspective lens or of its fisheye."""
_ALL = ("k1", "k2", "k3", "k4", "p1", "p2", "p3", "p4")


def read_calibration(paths: Sequence[tuple[str, Path]], cameras: Sequence[str]) -> Views | None:
    """Read the aligned cameras of a chunk by their labels; the unit is arbitrary without a scale.

    Raises BadInputError, with the camera, for missing values, other lens models and cameras that move.
    """
    path = paths[0][1]
    if (root := read_xml(path, "document")) is None or (chunk := root.find("chunk")) is None:
        return None
    posed = [
        camera
        for camera in chunk.iter("camera")
        if camera.find("transform") is not None and camera.get("enabled") not in ("false", "0")
    ]
    parts = {camera.get("component_id") for camera in posed}
    if len(parts) != 1:
        raise BadInputError(
            f"{path} has aligned cameras of {count(len(parts), 'component')}",
            hint="align all cameras into one component, and export them again",
        )
    owners = [*(owner for owner in chunk.iter("component") if owner.get("id") in parts), chunk]
    scale = next((text for owner in owners if (text := owner.findtext("transform/scale"))), None)
    metres = number(str(path), {"scale": 1.0 if scale is None else scale}, "scale")
    sensors = {sensor.get("id"): sensor for sensor in chunk.iter("sensor")}
    found = [
        (
            camera_of(label, cameras),
            _view(f"{path}: {label}", camera, sensors.get(camera.get("sensor_id")), metres),
        )
        for label, camera in ((camera.get("label", ""), camera) for camera in posed)
    ]
    views = views_of_images(
        str(path),
        found,
        "a rig stands still: export the cameras of one instant, labelled by the cameras' names",
    )
    return Views(views, path.name, assumed_unit="arbitrary" if scale is None else "m")


def _view(where: str, camera: ET.Element, sensor: ET.Element | None, metres: float) -> View:
    lens, size = (
        None if sensor is None else sensor.find(part) for part in ("calibration[last()]", "resolution")
    )
    if lens is None or size is None:
        raise BadInputError(f"{where} has no calibrated sensor", hint=EXPORT_AGAIN)
    width, height = (number(where, size.attrib, key) for key in ("width", "height"))
    model, given = lens.get("type", ""), {part.tag: part.text for part in lens}
    unread = [key for key in _ALL if key not in _READ.get(model, ()) and number(where, given, key, 0.0)]
    if model not in _READ or unread:
        raise BadInputError(
            f"{where} has a lens of type {model} with {', '.join(unread) or 'its own distortion'}; "
            "k1, k2, k3, p1, p2 of frame cameras and k1 to k4 of equidistant fisheyes are understood",
            hint="fit these only (Tools, Optimize Cameras), and export the cameras again",
        )
    f, b1, b2, cx, cy = (number(where, given, key, 0.0) for key in ("f", "b1", "b2", "cx", "cy"))
    pose = numbers(where, {"transform": (camera.findtext("transform") or "").split()}, "transform", 16)
    rotation, place = np.split(pose.reshape(4, 4)[:3], [3], axis=1)
    return View(
        matrix=np.array([[f + b1, b2, width / 2 + cx - 0.5], [0, f, height / 2 + cy - 0.5], [0, 0, 1]]),
        distortion=np.array([number(where, given, key, 0.0) for key in _READ[model]]),
        rotation=rotation.T,
        translation=-rotation.T @ place.ravel() * metres,
        size=(round(width), round(height)),
        is_fisheye=model != "frame",
    )


IMPORTER = Importer(
    program="Metashape",
    help="cameras.xml as a calibration",
    read_calibration=read_calibration,
    calibration_files=("cameras.xml",),
)
