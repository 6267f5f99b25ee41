"""Local planes of a depth map: in inverse depth a plane of the scene is a plane over the pixels."""

import cv2
import numpy as np

from reconstruction.geometry import Array


def fit_planes(
    inverse_depth: Array,
    tolerance: float,
    *,
    slopes: tuple[Array, Array] | None = None,
    reach: int = 2,
    stride: int = 1,
    rounds: int = 2,
) -> tuple[Array, Array, Array]:
    """Inverse depth and its slope per pixel in x and y (float32 height x width) of each pixel's own plane.

    Fitted by least squares to the neighbours within `reach * stride` px that lie within `tolerance` of the
    plane found before, so that no plane bridges an edge of depth; the first plane goes through the
    pixel's own depth and has these `slopes`, or none.
    """
    offsets = np.arange(-reach, reach + 1, dtype=int) * stride
    border = reach * stride
    # What lies beyond the picture is on no plane.
    padded = cv2.copyMakeBorder(
        inverse_depth, border, border, border, border, cv2.BORDER_CONSTANT, value=(-1e6,)
    )
    height, width = inverse_depth.shape
    unit = 1.0 / border
    level = inverse_depth
    flat = np.zeros_like(inverse_depth)
    right, down = (slope / unit for slope in slopes) if slopes else (flat, flat)
    for _ in range(rounds):
        sums = np.zeros((9, height, width), np.float32)
        for dy in offsets:
            for dx in offsets:
                x, y = dx * unit, dy * unit
                near = padded[border + dy : border + dy + height, border + dx : border + dx + width]
                gap = near - level
                off = gap - (x * right + y * down)
                off *= 1.0 / tolerance
                np.multiply(off, off, out=off)
                kept = np.maximum(1.0 - off, 0.0)
                value = gap * kept
                sums[0] += kept
                if x:
                    sums[1] += x * kept
                    sums[3] += (x * x) * kept
                    sums[7] += x * value
                if y:
                    sums[2] += y * kept
                    sums[5] += (y * y) * kept
                    sums[8] += y * value
                if x and y:
                    sums[4] += (x * y) * kept
                sums[6] += value
        level, right, down = _solve(sums, level, right, down)
    return level, right * unit, down * unit


def _solve(sums: Array, level: Array, right: Array, down: Array) -> tuple[Array, Array, Array]:
    """The planes of least squares by their normal equations; where these say too little, what was before."""
    n, sx, sy, xx, xy, yy, sv, xv, yv = sums
    n = np.maximum(n, 1e-6)
    mx, my, mv = sx / n, sy / n, sv / n
    # A little of the identity: along an edge of depth the slope across it is unknown, and taken as flat.
    cxx, cxy, cyy = xx / n - mx * mx + 0.01, xy / n - mx * my, yy / n - my * my + 0.01
    cxv, cyv = xv / n - mx * mv, yv / n - my * mv
    det = np.maximum(cxx * cyy - cxy * cxy, 1e-6)
    slope_x, slope_y = (cyy * cxv - cxy * cyv) / det, (cxx * cyv - cxy * cxv) / det
    enough = n > 3.0
    moved = level + mv - slope_x * mx - slope_y * my
    return (
        np.where(enough, moved, level).astype(np.float32),
        np.where(enough, slope_x, right).astype(np.float32),
        np.where(enough, slope_y, down).astype(np.float32),
    )


def normals(inverse_depth: Array, right: Array, down: Array, rays: Array) -> Array:
    """Unit normals (height x width x 3, float32) in the camera's frame, facing the camera.

    With w = a + right * x + down * y and rays (x', y', 1) of the pixels, the plane n . X = d has
    n / d = gradient of w along the rays.
    """
    per_x = right / max(float(rays[0, 0, 1] - rays[0, 0, 0]), 1e-12)
    per_y = down / max(float(rays[1, 1, 0] - rays[1, 0, 0]), 1e-12)
    along = inverse_depth - per_x * rays[0] - per_y * rays[1]
    normal = -np.stack([per_x, per_y, along], axis=-1)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.asarray(normal / np.maximum(length, 1e-12), np.float32)
