"""RealityCapture's (RealityScan's) XMP files, one beside each image, as a calibration.

According to support.capturingreality.com ("RealityCapture XMP Camera Math"), Rotation is row by row, t = -R
Position, and lenses are in units of the image's longer side from its middle; FocalLength35mm is for one of
36 mm. The coefficients are k1, k2, k3, k4, t1, t2; AliceVision, EasyVolcap and Camorph read t1 as OpenCV's
p2, and t2 as its p1.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.session.files.untrusted_files import read_input
from capture_app.session.importing.importer import Importer
from capture_app.session.importing.recording_sources import images_in
from capture_app.session.importing.views import (
    View,
    Views,
    camera_of,
    number,
    numbers,
    read_xml,
    views_of_images,
)
from capture_app.session.reading.decoding import image_size

_XCR = "{http://www.capturingreality.com/ns/xcr/1.1#}"
_LENS = ("FocalLength35mm", "AspectRatio", "Skew", "PrincipalPointU", "PrincipalPointV")
_MODELS = ("perspective", "brown3", "brown4", "brown3t2", "brown4t2")
_DEFAULTS = {key: ["0"] for key in _LENS[2:]} | {
    "AspectRatio": ["1"],
    "DistortionModel": _MODELS[:1],
    "DistortionCoeficients": ["0"] * 6,
}


def read_calibration(paths: Sequence[tuple[str, Path]], cameras: Sequence[str]) -> Views | None:
    """Read .xmp files, or a folder of them with their images; a file's path names its camera.

    Raises BadInputError, with the file, if it is malformed, is beside no image or has another lens model.
    """
    files = [
        (
            name or camera_of(str(file.relative_to(path) if path.is_dir() else file.name), cameras),
            _view(file, given),
        )
        for name, path in paths
        for file in (sorted(path.rglob("*.xmp")) if path.is_dir() else [path])
        if (given := _values(file))
    ]
    if not files:
        return None
    views = views_of_images(str(paths[0][1]), files, "a rig stands still: give the files of one instant")
    return Views(views, "RealityCapture's XMP", assumed_unit="arbitrary")


def _values(file: Path) -> dict[str, list[str]]:
    """Return RealityCapture's values in a file, which are attributes or elements; none if it has none."""
    if (root := read_xml(file, "x:xmpmeta")) is None:
        return {}
    said = [
        pair for element in root.iter() for pair in (*element.attrib.items(), (element.tag, element.text))
    ]
    return {key.removeprefix(_XCR): str(text).split() for key, text in said if key.startswith(_XCR)}


def _view(file: Path, said: dict[str, list[str]]) -> View:
    picture = next((image for image in images_in(file.parent) if image.stem == file.stem), None)
    if picture is None or (size := image_size(read_input(picture))) is None:
        raise BadInputError(
            f"{file} has no image beside it, and does not state the image's size",
            hint=f"put {file.stem}.jpg, which RealityCapture wrote it for, beside it",
        )
    where, given, side = str(file), {**_DEFAULTS, **said}, max(size)
    k1, k2, k3, k4, t1, t2 = numbers(where, given, "DistortionCoeficients", 6)
    if k4 or (model := " ".join(given["DistortionModel"])) not in _MODELS:
        raise BadInputError(
            f"{where} has {f'the distortion k4 = {k4:g}' if k4 else f'a lens of model {model}'}; "
            f"k1, k2, k3, t1, t2 of {', '.join(_MODELS)} are understood",
            hint="align again with the distortion model Brown3 (with tangential2), and export XMP again",
        )
    f, aspect, skew, u, v = (number(where, given, key) for key in _LENS)
    rotation = numbers(where, given, "Rotation", 9).reshape(3, 3)
    return View(
        matrix=np.array(
            [
                [f / 36 * side, skew * side, size[0] / 2 - 0.5 + u * side],
                [0, f / 36 * side * aspect, size[1] / 2 - 0.5 + v * side],
                [0, 0, 1],
            ]
        ),
        distortion=np.array([k1, k2, t2, t1, k3]),
        rotation=rotation,
        translation=-rotation @ numbers(where, given, "Position", 3),
        size=size,
    )


IMPORTER = Importer(
    program="RealityCapture",
    help="the .xmp beside each image as a calibration",
    read_calibration=read_calibration,
    calibration_per_camera=True,
    priority=-3,
)
