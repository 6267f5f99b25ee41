"""Accuracy and completeness of a fused cloud against true surfaces, for moving and still points."""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from capture_app.common.errors import NotAvailableError
from reconstruction.common.geometry import Array, View
from reconstruction.common.native_libraries import load_open3d
from reconstruction.depth.colmap_workspace import read_fused_cloud
from reconstruction.depth.visibility import project_points
from reconstruction.multiview.input_images import InputImage, undistorted_truth
from reconstruction.multiview.result import CloudScore
from reconstruction.scores.tally import Measurements
from reconstruction.session.dataset import Dataset

TOLERANCE_M = 0.01
"""Distance within which a point is right, and a true surface is found."""
MAX_SAMPLED = 20_000
"""Size of the random sample of larger point sets."""
MAX_WIDTH_PX = 960
VISIBLE_FRACTION = 0.01
"""Relative depth error below which a view sees a point, i.e. it is not occluded."""


class PointIndex:
    """Search index over points (n, 3), in metres, for neighbours within the tolerance."""

    def __init__(self, points: Array) -> None:
        core = load_open3d().core
        self._tensor = core.Tensor
        self._tree = None
        if len(points):
            self._tree = core.nns.NearestNeighborSearch(self._to_tensor(points))
            self._tree.hybrid_index(TOLERANCE_M)

    def count_near(self, asked: Array) -> tuple[int, int]:
        """Return the number of points with an indexed neighbour in the tolerance, and the sample size."""
        asked = _sample(asked)
        if self._tree is None or not len(asked):
            return 0, len(asked)
        _, _, found = self._tree.hybrid_search(self._to_tensor(asked), TOLERANCE_M, 1)
        return int((found.numpy() > 0).sum()), len(asked)

    def _to_tensor(self, points: Array) -> Any:
        return self._tensor(np.ascontiguousarray(points, np.float32))


TrueSurface = tuple[PointIndex, Array]
"""Index of all points that any view sees, and evenly spaced points (n, 3) that at least two views see.

A reconstruction can find only the latter.
"""


def known_surfaces(
    dataset: Dataset, views: Mapping[str, View], instant: int
) -> dict[str, TrueSurface] | None:
    """Return the true surfaces of an instant, see `true_surfaces`; None if a camera's truth is unknown.

    `views` have the distortion of the session's images.
    """
    loaded = {camera: undistorted_truth(dataset, view, camera, instant) for camera, view in views.items()}
    known = {camera: one for camera, one in loaded.items() if one is not None}
    if len(known) < len(loaded):
        return None
    plain = {camera: replace(view, distortion=np.zeros(5)) for camera, view in views.items()}
    depth, moving_masks = ({camera: one[which] for camera, one in known.items()} for which in (0, 1))
    return true_surfaces(plain, depth, moving_masks)


def true_surfaces(
    views: Mapping[str, View], depth: Mapping[str, Array], moving_masks: Mapping[str, Array]
) -> dict[str, TrueSurface]:
    """Return the moving (`mover`) and still (`static`) surfaces from undistorted true depth and masks (bool).

    Raises:
        NotAvailableError: Open3D is not installed.
    """
    parts: dict[str, list[Array]] = {"mover": [], "static": []}
    for name, view in views.items():
        step = max(1, round(view.width / MAX_WIDTH_PX))
        rows, columns = (axis[::step, ::step].ravel() for axis in np.mgrid[0 : view.height, 0 : view.width])
        z, moving = depth[name][rows, columns], moving_masks[name][rows, columns]
        points = _points(view, rows, columns, z)
        parts["mover"].append(points[(z > 0) & moving])
        parts["static"].append(points[(z > 0) & ~moving])
    found = {}
    for kind, every in parts.items():
        points = np.concatenate(every)
        asked = _sample(_thin_out(points))
        seen = sum(visible_points(view, depth[name], asked).astype(int) for name, view in views.items())
        found[kind] = PointIndex(points), asked[np.asarray(seen) >= 2]
    return found


def points_on_moving(
    points: Array, seen: Array, views: Mapping[str, View], moving_masks: Mapping[str, Array]
) -> Array:
    """Return the points (bool) that are on a moving object in most of the images they were fused from.

    `seen` (n, views) is bool, in the order of the views. `moving_masks`: each view's motion mask (bool).
    """
    votes = np.zeros(len(points), int)
    for place, (name, view) in enumerate(views.items()):
        votes += seen[:, place] & _on_mask(view, moving_masks[name], points)
    return np.asarray(2 * votes > seen.sum(1))


def points_on_masks(points: Array, views: Mapping[str, View], masks: Mapping[str, Array]) -> Array:
    """Return the points (bool) that any view sees on its mask (bool)."""
    touched = np.zeros(len(points), bool)
    for name, mask in masks.items():
        touched |= _on_mask(views[name], mask, points)
    return touched


def visible_points(view: View, depth: Array, points: Array) -> Array:
    """Return the points (bool) that a view sees, by its true depth; they are not occluded."""
    rows, columns, z, inside = project_points(view, points)
    return np.asarray(inside & (np.abs(depth[rows, columns] - z) < VISIBLE_FRACTION * z))


def _points(view: View, rows: Array, columns: Array, depth: Array) -> Array:
    """Return points (n, 3) float32 in the rig's frame."""
    back = (np.linalg.inv(view.matrix).T @ view.rotation).astype(np.float32)
    pixels = np.column_stack([columns, rows, np.ones(len(rows))]).astype(np.float32)
    return np.asarray((pixels @ back) * depth.astype(np.float32)[:, None] + view.centre.astype(np.float32))


def _on_mask(view: View, mask: Array, points: Array) -> Array:
    rows, columns, _, inside = project_points(view, points)
    return np.asarray(inside & mask[rows, columns])


def _sample(points: Array) -> Array:
    """Return at most MAX_SAMPLED of the points, always the same ones."""
    if len(points) <= MAX_SAMPLED:
        return points
    return np.asarray(points[np.random.default_rng(0).choice(len(points), MAX_SAMPLED, replace=False)])


def _thin_out(points: Array) -> Array:
    """Return one point for each cube with a side of one tolerance."""
    if not len(points):
        return points
    cubes = np.floor((points - points.min(0)) / TOLERANCE_M).astype(np.int64)
    # A million cubes along each axis, ten kilometres, suffice for any scene.
    keys = (cubes[:, 0] << 40) | (cubes[:, 1] << 20) | cubes[:, 2]
    return np.asarray(points[np.unique(keys, return_index=True)[1]])


def score_moving(
    dataset: Dataset, images: Mapping[str, InputImage], unit: str, instant: int, cloud: Path
) -> CloudScore | None:
    """Score the moving points of a fused cloud against the true surfaces of an instant.

    `images` are the images it was fused from, in order; some may be of other instants. None if the truth is
    unknown, the calibration (in `unit`) is not metric, nothing moves, or Open3D is not installed.
    """
    if unit != "m":
        return None
    shown = {c: undistorted_truth(dataset, image.view, c, image.instant) for c, image in images.items()}
    moving_masks = {camera: one[1] for camera, one in shown.items() if one is not None}
    try:
        known = known_surfaces(dataset, {c: image.view for c, image in images.items()}, instant)
    except NotAvailableError:
        return None
    if known is None or len(moving_masks) < len(images):
        return None
    index, shared = known["mover"]
    views = {camera: image.calibrated.view for camera, image in images.items()}
    points, _, seen = read_fused_cloud(cloud, len(images))
    points = points[points_on_moving(points, seen, views, moving_masks)]
    precise, complete = index.count_near(points), PointIndex(points).count_near(shared)
    found = Measurements({"precision": precise, "recall": complete})
    precision, recall, f_score = (found.value(name) for name in ("precision", "recall", "f_score"))
    if math.isnan(recall):
        return None
    return CloudScore(
        points=len(points),
        precision=None if math.isnan(precision) else round(precision, 4),
        recall=round(recall, 4),
        f_score=round(f_score, 4),
    )
