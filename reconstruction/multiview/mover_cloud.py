"""How right and how complete the movers of a fused cloud are, where a session knows the truth."""

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from capture_app.errors import NotAvailableError
from reconstruction.common.geometry import Array
from reconstruction.depth.colmap_workspace import read_fused_cloud
from reconstruction.multiview.cloud_accuracy import PointIndex, points_on_movers, true_surfaces
from reconstruction.multiview.input_images import InputImage, undistort_nearest
from reconstruction.multiview.result import CloudScore
from reconstruction.scores.tally import Measurements
from reconstruction.session.dataset import Dataset


def score_movers(
    dataset: Dataset, images: Mapping[str, InputImage], unit: str, instant: int, cloud: Path
) -> CloudScore | None:
    """Hold what moves in a fused cloud against the true surfaces of an instant.

    `images` are those it was fused from, in that order; some may be of other instants. None where the truth
    is not known, the calibration (in `unit`) knows no metres, nothing moves, or Open3D is not here.
    """
    if unit != "m":
        return None
    surfaces = {camera: _truth(dataset, image, instant) for camera, image in images.items()}
    shown = {camera: _truth(dataset, image, image.instant) for camera, image in images.items()}
    true = {camera: one for camera, one in surfaces.items() if one is not None}
    movers = {camera: one[1] for camera, one in shown.items() if one is not None}
    if not len(true) == len(movers) == len(images):
        return None
    views = {camera: image.calibrated.view for camera, image in images.items()}
    depth = {camera: one[0] for camera, one in true.items()}
    try:
        surface = true_surfaces(views, depth, {camera: one[1] for camera, one in true.items()})["mover"]
    except NotAvailableError:
        return None
    fused = read_fused_cloud(cloud, len(images))
    points = fused.points[points_on_movers(fused.points, fused.seen, views, movers)]
    precise, complete = surface.index.count_near(points), PointIndex(points).count_near(surface.shared)
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


def _truth(dataset: Dataset, image: InputImage, instant: int) -> tuple[Array, Array] | None:
    """True depth (m) and movers (bool), undistorted as the picture is."""
    truth = dataset.ground_truth(image.camera, instant)
    if truth is None:
        return None
    depth, movers = truth[0], truth[1].astype(np.uint8)
    return undistort_nearest(image.view, depth), undistort_nearest(image.view, movers) > 0
