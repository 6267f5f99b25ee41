"""One camera's depth as files, and its shares where the true depth is known."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from reconstruction.common.drawing import colour_depth
from reconstruction.common.geometry import Array
from reconstruction.depth.sweep_matcher import ViewDepth
from reconstruction.multiview.input_images import InputImage
from reconstruction.multiview.result import ViewResult
from reconstruction.session.dataset import Dataset

ERROR_SHARE = 0.02


def write_view(
    dataset: Dataset, shot: InputImage, found: ViewDepth, sources: Sequence[str], part: Path
) -> ViewResult:
    """Write a camera's depth, normals and picture into `part`/depth, and judge them."""
    name = f"depth/{shot.camera}"
    np.savez(part / f"{name}.npz", depth=found.depth, normals=found.normals.astype(np.float16))
    known = found.depth[found.depth > 0]
    near, far = np.percentile(known, [1, 99]) if known.size else (1.0, 2.0)
    cv2.imwrite(
        str(part / f"{name}.png"), colour_depth(found.depth, float(near), float(max(far, near * 1.05)))
    )
    shares: dict[str, float | None] = {}
    truth = dataset.truth(shot.camera, shot.instant)
    if truth is not None:
        depth = shot.flatten(np.where(np.isfinite(truth[0]), truth[0], 0).astype(np.float32))
        shares = judge(found.depth, depth, shot.flatten(truth[1].astype(np.uint8)) > 0)
    return ViewResult(
        camera=shot.camera,
        instant=shot.instant,
        sources=tuple(sources),
        coverage=round(float(np.mean(found.depth > 0)), 4),
        depth=f"{name}.npz",
        picture=f"{name}.png",
        **shares,
    )


def judge(depth: Array, truth: Array, movers: Array) -> dict[str, float | None]:
    """Shares of a depth map by a true one (0 = unknown) and a mask of what moves, all height x width."""
    known = truth > 0
    error = np.abs(depth - truth) / np.where(known, truth, 1)
    right = (depth > 0) & known & (error < ERROR_SHARE)
    there = (depth > 0) & known

    def share(of: Array, among: Array) -> float | None:
        return round(float(of[among].mean()), 4) if among.any() else None

    return {
        "within_2pct": share(right, known),
        "mover_within_2pct": share(right, known & movers),
        "static_within_2pct": share(right, known & ~movers),
        "mover_coverage": share(there, known & movers),
        "median_error_pct": round(100 * float(np.median(error[there])), 4) if there.any() else None,
    }
