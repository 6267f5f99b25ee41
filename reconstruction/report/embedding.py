"""Pictures and clouds inside a page, packed into few bytes."""

import base64
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from capture_app.errors import BadInputError
from reconstruction.common.geometry import Array
from reconstruction.common.outputs import read_points
from reconstruction.scores.study_result import InstantClouds

MAX_POINTS = 26_000
"""Points of each side, drawn at random: the page stays under three megabytes."""
CROP = 0.5
"""Percentiles left out at either end of each axis: single points far away would shrink all others."""
STEPS = 32_767
PNG, JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff"
QUALITY = 74
"""The quality of photographs, as WebP."""
LOSSLESS = 101
"""OpenCV's word for a WebP without loss: flat colours and hard edges stay as they are."""
MAX_PANEL_PX = 1024
"""What is wider is made smaller: no page shows more."""


@dataclass(frozen=True)
class EmbeddedImage:
    """A picture as a `data:` address, and its size, px."""

    address: str
    width: int
    height: int


def embed_image(path: Path, panels: int = 1, most_px: int = MAX_PANEL_PX) -> EmbeddedImage:
    """Read a PNG or JPEG and pack it for a page, each of its `panels` side by side `most_px` wide at most.

    Raises:
        BadInputError: the file is missing, or is no PNG or JPEG.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise BadInputError(
            f"the report lacks the picture {path}: {error.strerror or error}",
            hint="compare the session again",
        ) from error
    known = data.startswith((PNG, JPEG))
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) if known else None
    if image is None:
        raise BadInputError(
            f"the picture {path} is not a readable PNG or JPEG", hint="compare the session again"
        )
    shown = _shrink(image, most_px * panels)
    quality = LOSSLESS if data.startswith(PNG) else QUALITY
    _, packed = cv2.imencode(".webp", shown, [cv2.IMWRITE_WEBP_QUALITY, quality])
    address = f"data:image/webp;base64,{base64.b64encode(packed.tobytes()).decode()}"
    return EmbeddedImage(address, width=shown.shape[1], height=shown.shape[0])


def _shrink(image: Array, most: int) -> Array:
    height, width = image.shape[:2]
    if width <= most:
        return np.asarray(image)
    size = (most, max(1, round(height * most / width)))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))


@dataclass(frozen=True)
class PackedCloud:
    """A cloud to be turned by hand, as base64: x, y, z of each point as int16, then each one's colour (RGB).

    A coordinate is `middle` + `step` times the integer, along the first camera's axes (x right, y down).
    """

    data: str
    middle: tuple[float, ...]
    step: float
    points: int
    of: int
    """Points of the whole cloud."""


@dataclass(frozen=True)
class CloudView:
    """Both sides or one, what they turn about, and the focal length over the picture's width."""

    files: InstantClouds
    reference: str
    """The camera from whose place they are seen first."""
    cameras: int
    synced: PackedCloud
    offset: PackedCloud | None
    pivot: tuple[float, ...]
    focal: float


def view_clouds(clouds: InstantClouds, out: Path, reference: str, cameras: int) -> CloudView:
    """Read the files and pack them.

    Raises:
        BadInputError: a file is missing or not as it was written.
    """
    rotation = np.array(clouds.rotation).reshape(3, 3)
    centre = np.array(clouds.centre)
    sides = {}
    for side, name in (("synced", clouds.synced), ("offset", clouds.offset)):
        if name:
            points, colours = read_points(out / name)
            sides[side] = ((points - centre) @ rotation.T, colours)
    box = np.percentile(sides["synced"][0], [CROP, 100 - CROP], axis=0)
    pivot = (np.array(clouds.pivot) - centre) @ rotation.T
    return CloudView(
        clouds,
        reference,
        cameras,
        synced=_pack(*sides["synced"], box),
        offset=_pack(*sides["offset"], box) if "offset" in sides else None,
        pivot=tuple(pivot.tolist()),
        focal=clouds.focal,
    )


def _pack(points: Array, colours: Array, box: Array) -> PackedCloud:
    """Points within the box (2, 3) only: both sides show the same part of space."""
    inside = np.nonzero(((points >= box[0]) & (points <= box[1])).all(1))[0]
    if len(inside) > MAX_POINTS:
        inside = np.sort(np.random.default_rng(0).choice(inside, MAX_POINTS, replace=False))
    middle = box.mean(0)
    step = max(float((box[1] - box[0]).max()) / 2 / STEPS, 1e-12)
    places = np.round((points[inside] - middle) / step).astype("<i2")
    data = places.tobytes() + np.ascontiguousarray(colours[inside], np.uint8).tobytes()
    return PackedCloud(
        base64.b64encode(data).decode(), tuple(middle.tolist()), step, len(inside), len(points)
    )
