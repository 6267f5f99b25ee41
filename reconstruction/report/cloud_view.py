"""A cloud packed for a page where it is turned by hand: few bytes, in the frame of its first camera."""

import base64
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.common.outputs import read_points
from reconstruction.scores.study_result import InstantClouds

MAX_POINTS = 26_000
"""Points of each side, drawn at random: the page stays under three megabytes."""
CROP = 0.5
"""Percentiles left out at either end of each axis: single points far away would shrink all others."""
STEPS = 32_767


@dataclass(frozen=True)
class PackedCloud:
    """Points as base64: x, y and z of each as int16, then red, green and blue of each as uint8.

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
    """Both sides, what they turn about, and the focal length over the picture's width."""

    synced: PackedCloud
    offset: PackedCloud
    pivot: tuple[float, ...]
    focal: float


def view_clouds(clouds: InstantClouds, out: Path) -> CloudView:
    """Read both files and pack them.

    Raises:
        BadInputError: a file is missing or not as it was written.
    """
    rotation = np.array(clouds.rotation).reshape(3, 3)
    centre = np.array(clouds.centre)
    sides = {}
    for side in ("synced", "offset"):
        points, colours = read_points(out / getattr(clouds, side))
        sides[side] = ((points - centre) @ rotation.T, colours)
    box = np.percentile(sides["synced"][0], [CROP, 100 - CROP], axis=0)
    pivot = (np.array(clouds.pivot) - centre) @ rotation.T
    return CloudView(
        **{side: _pack(*cloud, box) for side, cloud in sides.items()},
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
