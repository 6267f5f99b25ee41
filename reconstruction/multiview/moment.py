"""Page with a 3D view of one instant's cloud, and the fraction of moving pixels that was measured."""

from pathlib import Path

import numpy as np

from capture_app.session.exporting.point_cloud import PointCloud, write_ply
from reconstruction.common.geometry import Array
from reconstruction.depth.colmap_workspace import read_fused_cloud
from reconstruction.multiview.input_images import InputImage, find_moving
from reconstruction.multiview.result import MultiviewResult
from reconstruction.report.embedding import view_clouds
from reconstruction.report.page import REPORT, Section, render_page, write_page
from reconstruction.report.wording import percentage
from reconstruction.scores.study_result import InstantClouds
from reconstruction.session.moving_pixels import SceneMotion

POINTS = "points.ply"
FILES = (POINTS, REPORT)


def measured_fraction(image: InputImage, depth: Array, motion: SceneMotion) -> float | None:
    """Return the fraction of an image's moving pixels with depth; None if nothing moves or it is unknown."""
    moving = find_moving(image, motion)
    return None if moving is None or not moving.any() else round(float((depth[moving] > 0).mean()), 4)


def write_moment(result: MultiviewResult, image: InputImage, depth: Array, fused: Path) -> None:
    """Write `FILES` beside a fused cloud: its points, and the page that shows them in 3D.

    `image` and `depth` belong to the reference camera.
    """
    points, colours, _ = read_fused_cloud(fused, len(result.views))
    write_ply(fused.with_name(POINTS), PointCloud(points, colours))
    view = image.calibrated.view
    clouds = InstantClouds(
        instant=result.instant,
        synced=POINTS,
        rotation=tuple(view.rotation.ravel().tolist()),
        centre=tuple(view.centre.tolist()),
        focal=view.focal / view.width,
        pivot=tuple(np.median(points, axis=0).tolist()),
    )
    measured = result.moving_measured
    moving = "" if measured is None else f" {percentage(measured)} of what moves was measured."
    page = {
        "title": f"{result.session}, instant {result.instant}",
        "kicker": "One instant in space",
        "name": result.session,
        "verdict": f"{result.fused_points:,} points from {len(result.views)} cameras.{moving}",
        "numbers_in": ("multiview.json",),
        "cloud": view_clouds(clouds, fused.parent, result.reference, len(result.views)),
        "scripts": ("cloud.js",),
    }
    write_page(render_page(page, [Section("cloud.html")]), fused.parent)
