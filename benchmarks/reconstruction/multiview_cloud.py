"""Comparison of a fused cloud with the true surfaces."""

from pathlib import Path

import numpy as np

from reconstruction.common.geometry import Array, View
from reconstruction.common.native_libraries import load_open3d
from reconstruction.multiview.instant_scoring import TOLERANCE_M, visible_points


def cloud_scores(cloud: Path, views: dict[str, View], depth: dict[str, Array]) -> dict[str, float]:
    """Return precision, recall and F-score at 1 cm.

    The truth is what at least two views see, one point per centimetre: nothing else can be reconstructed.
    """
    o3d = load_open3d()
    every = [_points(view, depth[name]) for name, view in views.items()]
    shared = []
    for name, points in zip(views, every, strict=True):
        seen = np.zeros(len(points), bool)
        for other, other_view in views.items():
            if other != name:
                seen |= visible_points(other_view, depth[other], points)
        shared.append(points[seen])
    truth = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.concatenate(every)))
    wanted = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.concatenate(shared)))
    wanted = wanted.voxel_down_sample(TOLERANCE_M)
    found = o3d.io.read_point_cloud(str(cloud))
    precision = float(np.mean(np.asarray(found.compute_point_cloud_distance(truth)) < TOLERANCE_M))
    recall = float(np.mean(np.asarray(wanted.compute_point_cloud_distance(found)) < TOLERANCE_M))
    return {
        "precision_1cm": precision,
        "recall_1cm": recall,
        "f_score_1cm": 2 * precision * recall / max(precision + recall, 1e-9),
    }


def _points(view: View, depth: Array) -> Array:
    rays = view.rays(view.grid())
    z = depth.reshape(-1)
    there = z > 0
    return np.asarray((rays[there] * z[there, None] - view.translation) @ view.rotation)
