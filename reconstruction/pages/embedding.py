"""Images and point clouds embedded in a page in compact form."""

import base64
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from msgspec import Struct

from capture_app.common.errors import BadInputError
from capture_app.session.exporting.point_cloud import read_ply
from reconstruction.common.geometry import Array

MAX_POINTS = 400_000
"""Maximum points of all conditions, drawn at random: 4.8 MB of the page."""
CROP = 0.5
"""Percentiles cropped at both ends of each axis; a few distant points would shrink all others."""
STEPS = 32_767
PNG, JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff"
QUALITY = 74
"""WebP quality of photographs."""


class InstantClouds(Struct, frozen=True, kw_only=True):
    """Fused clouds of one instant, with the viewpoint; paths of PLY files in the rig's frame."""

    instant: int
    synced: str
    offset: str = ""
    """Cloud of the offset condition; empty if only the synchronized cloud exists."""
    rotation: tuple[float, ...]
    """Rotation from the rig's frame to the reference camera's frame, row by row."""
    centre: tuple[float, ...]
    """Position of the reference camera."""
    focal: float
    """Focal length of the reference camera divided by its image width."""
    pivot: tuple[float, ...]
    """Point about which the view rotates: the centre of what moves."""


def embed_image(path: Path, panels: int = 1, max_px: int = 1024) -> dict[str, object]:
    """Read a PNG or JPEG and encode it for a page, each of its `panels` side by side at most `max_px` wide.

    Returns its `address` (`data:`), `width` and `height`, px.

    Raises:
        BadInputError: the file is missing, or is neither PNG nor JPEG.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise BadInputError(
            f"the report lacks the picture {path}: {error.strerror or error}",
            hint="compare the session again",
        ) from error
    if (packed := _as_webp(data, max_px * panels)) is None:
        raise BadInputError(
            f"the picture {path} is not a readable PNG or JPEG", hint="compare the session again"
        )
    return packed


@lru_cache(maxsize=128)
def _as_webp(data: bytes, max_px: int) -> dict[str, object] | None:
    """Return a picture's file as `embed_image` does; None if it is neither PNG nor JPEG."""
    known = data.startswith((PNG, JPEG))
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) if known else None
    if image is None:
        return None
    height, width = image.shape[:2]
    if width > max_px:
        width, height = max_px, max(1, round(height * max_px / width))
        image = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    # OpenCV's value for lossless WebP, which preserves flat colours and hard edges.
    quality = 101 if data.startswith(PNG) else QUALITY
    _, packed = cv2.imencode(".webp", image, [cv2.IMWRITE_WEBP_QUALITY, quality])
    address = f"data:image/webp;base64,{base64.b64encode(packed.tobytes()).decode()}"
    return {"address": address, "width": width, "height": height}


def view_clouds(clouds: InstantClouds, out: Path, reference: str, cameras: int) -> dict[str, Any]:
    """Read the clouds of one instant and pack both conditions, or one (`offset`: None), for a 3D viewer.

    The view starts behind the `reference` camera and rotates about the `pivot`. `focal` is the focal length
    over the image width. Each condition has base64 `data`: x, y, z of each point as int16, then each point's
    colour (RGB). A coordinate is `middle` + `step` times the integer, along the reference's axes (x right, y
    down). `points` is the number packed `of` all points.

    Raises:
        IncompleteError: a file is missing.
        BadInputError: a file is corrupt.
    """
    rotation = np.array(clouds.rotation).reshape(3, 3)
    centre = np.array(clouds.centre)
    read = {
        condition: read_ply(out / name)
        for condition, name in (("synced", clouds.synced), ("offset", clouds.offset))
        if name
    }
    places = {condition: (cloud.points - centre) @ rotation.T for condition, cloud in read.items()}
    box = np.percentile(places["synced"], [CROP, 100 - CROP], axis=0)
    packed = {
        path: _pack(places[path], cloud.colours, box, MAX_POINTS // len(read)) for path, cloud in read.items()
    }
    return {
        "files": clouds,
        "reference": reference,
        "cameras": cameras,
        "synced": packed["synced"],
        "offset": packed.get("offset"),
        "pivot": ((np.array(clouds.pivot) - centre) @ rotation.T).tolist(),
        "focal": clouds.focal,
    }


def _pack(points: Array, colours: Array, box: Array, limit: int) -> dict[str, object]:
    """Pack at most `limit` points inside the box (2, 3): both conditions show the same part of space."""
    inside = np.nonzero(((points >= box[0]) & (points <= box[1])).all(1))[0]
    if len(inside) > limit:
        inside = np.sort(np.random.default_rng(0).choice(inside, limit, replace=False))
    middle = box.mean(0)
    step = max(float((box[1] - box[0]).max()) / 2 / STEPS, 1e-12)
    places = np.round((points[inside] - middle) / step).astype("<i2")
    data = places.tobytes() + np.ascontiguousarray(colours[inside], np.uint8).tobytes()
    return {
        "data": base64.b64encode(data).decode(),
        "middle": middle.tolist(),
        "step": step,
        "points": len(inside),
        "of": len(points),
    }
