"""Visibility test: points that contradict the depths measured by other views."""

from collections.abc import Mapping

import cv2
import numpy as np

from reconstruction.common.geometry import Array, View
from reconstruction.depth.sweep_matcher import ViewDepth

SLACK = 0.005
"""Maximum relative depth difference of the same surface."""
BEHIND = -0.3
"""Maximum cosine between a point's normal and the direction to a view that sees it from behind."""


def find_denied(
    points: Array, normals: Array, views: Mapping[str, View], depth_views: Mapping[str, ViewDepth]
) -> Array:
    """Return which surface points (n, 3) views deny (bool), unless over twice as many others confirm them.

    A view confirms a point that faces it if it measured that depth. It denies a point if it clearly measured
    something farther, through the point. It also denies a point that is turned away from it if it measured
    nothing in front of it, as solid objects are not seen from behind.
    """
    confirming, denying = (np.zeros(len(points), np.uint16) for _ in range(2))
    for name, found in depth_views.items():
        view = views[name]
        rows, columns, z, inside = project_points(view, points)
        towards = view.centre.astype(np.float32) - points
        cosine = (towards * normals).sum(1) / np.linalg.norm(towards, axis=1)
        measured = found.depth[rows, columns]
        confirming += inside & (cosine > 0) & (np.abs(measured - z) < SLACK * z)
        # Zero if any neighbouring pixel has no depth.
        nearest = cv2.erode(found.depth, np.ones((3, 3), np.uint8))[rows, columns]
        denying += inside & (nearest > np.where(cosine < BEHIND, 1 - SLACK, 1 + SLACK) * z)
    return np.asarray((denying > 0) & (confirming <= 2 * denying))


def project_points(view: View, points: Array) -> tuple[Array, Array, Array, Array]:
    """Return the rows and columns of the pixels that points project to, their depth, and which are inside."""
    onto = (view.matrix @ view.rotation).astype(np.float32)
    x, y, z = (points.astype(np.float32) @ onto.T + (view.matrix @ view.translation).astype(np.float32)).T
    ahead = z > 1e-6
    far = 1 / np.where(ahead, z, 1)
    columns, rows = np.rint(x * far), np.rint(y * far)
    inside = ahead & (columns >= 0) & (columns < view.width) & (rows >= 0) & (rows < view.height)
    rows, columns = (np.where(inside, axis, 0).astype(np.int32) for axis in (rows, columns))
    return rows, columns, z, inside
