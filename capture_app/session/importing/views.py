"""Format-independent cameras of a calibration file, matched to a rig by name or by image path."""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any
from xml.etree import ElementTree as ET

import msgspec
import numpy as np
from msgspec import UNSET, UnsetType

from capture_app.common.errors import BadInputError
from capture_app.common.text import UNREADABLE
from capture_app.session.files.untrusted_files import read_input, read_text, rejecting, within
from capture_app.session.format.calibration import CameraCalibration, LensKnowledge
from capture_app.session.format.lens import Array

SAME_ROTATION, SAME_PLACE = 1e-5, 1e-5
"""Maximum difference of two equal rotation matrices, and of two positions relative to the rig's extent."""
MAX_NUMBERS, MAX_XML_BYTES, MAX_JSON_BYTES, MAX_JSON_PARTS = 1 << 10, 1 << 21, 1 << 24, 500_000
"""Maxima of a calibration: numbers at one key, bytes of its file, and lists and objects in it.

Decoded, an XML element takes up to 90 bytes for each of its own, and an empty list of JSON 64.
"""
EXPORT_AGAIN = "export the calibration again with the program that made it"


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """One camera of a calibration file: 3x3 matrix in px, OpenCV distortion, and x_cam = R x_rig + t.

    `rotation` is 3x3, `translation` (3,) in the file's unit; `size` is (width, height) in px, None if the
    file does not state it. The first pixel's centre is (0, 0).
    """

    matrix: Array
    distortion: Array
    rotation: Array
    translation: Array
    size: tuple[int, int] | None = None
    turned: str = ""
    """What the file says of images that are turned after the lens was calibrated; empty if nothing."""
    is_fisheye: bool = False
    """Whether `distortion` is k1 to k4 of OpenCV's fisheye model."""
    unrectified: "View | None" = None
    """The same camera without rectification, for images of that one's size; None if its file has none."""


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """All cameras of a file by the file's own labels; `unit` is the format's, None if it has none."""

    cameras: Mapping[str, View | CameraCalibration]
    """A file of ours has our cameras; other programs' are converted, in one place."""
    source: str
    unit: str | None = None
    assumed_unit: str = "m"
    """Unit if neither the file nor the user states one: `arbitrary` for formats without a scale."""
    lenses: LensKnowledge | UnsetType = UNSET
    """What the file says of its focal lengths; see `Calibration.lenses`."""


def read_json(path: Path) -> Any:
    """Decode a .json file; None for any other file. Raises BadInputError if it cannot be read."""
    if path.suffix.lower() != ".json":
        return None
    with rejecting(f"cannot read {path} as JSON", ValueError, *UNREADABLE, hint=EXPORT_AGAIN):
        text = read_text(path, max_bytes=MAX_JSON_BYTES)
        within(text.count("[") + text.count("{"), MAX_JSON_PARTS, "lists and objects")
        return msgspec.json.decode(text)


def root_of(path: Path) -> str:
    """Return the name of an XML file's first element; empty for any other file."""
    if path.is_dir():
        return ""
    with path.open("rb") as file:
        begin = file.read(4096)
    # Declarations and comments begin with ? and !.
    first = re.search(rb"<([A-Za-z_][\w.:-]*)", re.sub(rb"<!--.*?-->", b"", begin, flags=re.DOTALL))
    return first[1].decode() if first and begin.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<") else ""


def read_xml(path: Path, root: str) -> ET.Element | None:
    """Parse an XML file whose first element has this name; None for any other file. Raises BadInputError."""
    if root_of(path) != root:
        return None
    errors = OSError, ET.ParseError, LookupError, ValueError
    with rejecting(f"cannot read the calibration {path}", *errors, hint=EXPORT_AGAIN):
        # expat resolves no external entities and limits the others.
        return ET.fromstring(read_input(path, max_bytes=MAX_XML_BYTES))  # noqa: S314


def numbers(
    where: str, content: Mapping[Any, Any], key: str, *counts: int, hint: str = EXPORT_AGAIN
) -> Array:
    """Return the numbers at a key as a flat array. Raises BadInputError if they are missing or invalid."""
    if content.get(key) is None:
        raise BadInputError(f"{where} has no {key}", hint=hint)
    with rejecting(f"{where}: {key} is not made of numbers", TypeError, ValueError, OverflowError, hint=hint):
        within(getattr(content[key], "size", 1), MAX_NUMBERS, "numbers")
        values = np.asarray(content[key], np.float64).ravel()
    if values.size not in counts:
        raise BadInputError(
            f"{where}: {key} has {values.size} numbers, not {' or '.join(map(str, counts))}", hint=hint
        )
    if not np.isfinite(values).all():
        raise BadInputError(f"{where}: {key} has numbers that are not finite", hint=hint)
    return values


def number(where: str, content: Mapping[Any, Any], key: str, default: float | None = None) -> float:
    """Return the number at a key, `default` if it is missing. Raises BadInputError as `numbers` does."""
    return float(numbers(where, {key: default, **content}, key, 1)[0])


def size_of(where: str, content: Mapping[Any, Any], key: str) -> tuple[int, int]:
    """Return the width and height at a key, in px. Raises BadInputError as `numbers` does."""
    width, height = numbers(where, content, key, 2)
    return round(width), round(height)


def pinhole(fx: float, fy: float, cx: float, cy: float) -> Array:
    """Return the 3x3 camera matrix of focal lengths and a principal point in px."""
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)


def rotation_of(values: Array) -> Array:
    """Return the rotation matrix (3x3) of 9 numbers or of a Rodrigues vector."""
    import cv2

    return values.reshape(3, 3) if values.size == 9 else np.asarray(cv2.Rodrigues(values)[0], np.float64)


def from_quaternion(where: str, wxyz: Sequence[float] | Array) -> Array:
    """Return the rotation matrix (3x3) of a quaternion (w, x, y, z) of any length (Horn 1987).

    Raises BadInputError, with a message that begins with `where`, if the length is 0 or not finite.
    """
    quaternion = np.asarray(wxyz, np.float64)
    length = math.hypot(*quaternion)
    if not 1e-9 < length < 1e9:
        raise BadInputError(
            f"{where} has the rotation {list(wxyz)}, which is not a quaternion", hint=EXPORT_AGAIN
        )
    w, x, y, z = quaternion / length
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def camera_of(image: str, cameras: Sequence[str]) -> str:
    """Return the camera of an image path: the part that is a camera's name, otherwise the folder's name.

    For an image without a folder it is the file name without suffix, as with one image a camera. Raises
    BadInputError for a path without a name.
    """
    path = PurePosixPath(image.replace("\\", "/"))
    if not path.name:
        raise BadInputError(f"{image!r} is not the path of an image", hint=EXPORT_AGAIN)
    parts = path.with_suffix("").parts
    names = {name.casefold(): name for name in cameras}
    for part in reversed(parts):
        if part.casefold() in names:
            return names[part.casefold()]
    return parts[-2] if len(parts) > 1 else parts[-1]


def views_of_images(where: str, images: Iterable[tuple[str, View]], hint: str) -> dict[str, View]:
    """Return one view for each camera, from images as (camera, view).

    Raises BadInputError, beginning with `where`, if a camera moves or changes between its images.
    """
    views: dict[str, View] = {}
    rest = [(name, view) for name, view in images if views.setdefault(name, view) is not view]
    extent = max((math.hypot(*view.translation) for view in views.values()), default=0.0)
    if moved := [name for name, view in rest if not _same_view(views[name], view, extent)]:
        raise BadInputError(f"{where}: camera {moved[0]} is not in one place in all of its images", hint=hint)
    return views


def _same_view(view: View, other: View, extent: float) -> bool:
    """Return whether two views have one pose and lens; `extent` is the rig's, in the translations' unit."""
    return (
        view.size == other.size
        and view.is_fisheye == other.is_fisheye
        and np.array_equal(view.matrix, other.matrix)
        and np.array_equal(view.distortion, other.distortion)
        and bool(np.abs(view.rotation - other.rotation).max() <= SAME_ROTATION)
        and bool(np.abs(view.translation - other.translation).max() <= SAME_PLACE * extent)
    )
