"""One camera's depth as files, and its shares where the true depth is known."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from reconstruction.common.drawing import colour_depth, display_range
from reconstruction.common.image_files import write_image
from reconstruction.depth.sweep_matcher import ViewDepth
from reconstruction.multiview.input_images import InputImage
from reconstruction.multiview.result import ViewResult
from reconstruction.scores.depth_truth import depth_shares
from reconstruction.session.dataset import Dataset


def write_view(
    dataset: Dataset, image: InputImage, found: ViewDepth, sources: Sequence[str], part: Path
) -> ViewResult:
    """Write a camera's depth, normals and picture into `part`/depth, and judge them."""
    name = f"depth/{image.camera}"
    np.savez(part / f"{name}.npz", depth=found.depth, normals=found.normals.astype(np.float16))
    write_image(part / f"{name}.png", colour_depth(found.depth, *display_range(found.depth)))
    shares: dict[str, float | None] = {}
    truth = dataset.ground_truth(image.camera, image.instant)
    if truth is not None:
        movers = image.undistort_nearest(truth[1].astype(np.uint8)) > 0
        shares = depth_shares(found.depth, image.undistort_nearest(truth[0]), movers)
    return ViewResult(
        camera=image.camera,
        instant=image.instant,
        sources=tuple(sources),
        coverage=round(float(np.mean(found.depth > 0)), 4),
        depth=f"{name}.npz",
        picture=f"{name}.png",
        **shares,
    )
