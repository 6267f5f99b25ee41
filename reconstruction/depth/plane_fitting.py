"""Local plane fits to a depth map; a plane of the scene is linear in inverse depth over the pixels."""

import cv2
import numpy as np

from reconstruction.common.geometry import Array

BAND = 32


def fit_planes(
    inverse_depth: Array,
    tolerance: float,
    *,
    slopes: Array | None = None,
    radius: int = 2,
    stride: int = 1,
    rounds: int = 2,
) -> Array:
    """Fit a plane at each pixel: inverse depth and its slope per pixel in x and y (3 x height x width).

    The result is float32. The fit is by least squares to the neighbours within `radius * stride` px that are
    within `tolerance` of the previous plane, so that no plane bridges a depth edge. The first plane goes
    through the pixel's own depth and has these `slopes` (2 x height x width), or none.
    """
    border = radius * stride
    # Beyond the image there is no plane.
    padded = cv2.copyMakeBorder(
        inverse_depth, border, border, border, border, cv2.BORDER_CONSTANT, value=(-1e6,)
    )
    unit = 1.0 / border
    planes = np.zeros((3, *inverse_depth.shape), np.float32)
    planes[0] = inverse_depth
    if slopes is not None:
        planes[1:] = slopes / unit
    steps = np.arange(-radius, radius + 1, dtype=int) * stride
    # A band of rows at a time stays in the processor's cache.
    for top in range(0, len(inverse_depth), BAND):
        band = np.s_[:, top : top + BAND]
        around = padded[top : top + BAND + 2 * border]
        for _ in range(rounds):
            planes[band] = _solve(_weighed(around, planes[band], steps, tolerance), planes[band])
    planes[1:] *= np.float32(unit)
    return planes


def _weighed(around: Array, plane: Array, steps: Array, tolerance: float) -> Array:
    """Return sums for the normal equations (9, height, width), weighting neighbours near the plane more.

    `around` contains the inverse depths of a band with a border. The sums, over the neighbours' positions and
    their gaps to the plane's level, are: n, x, y, xx, xy, yy, gap, x gap, y gap.
    """
    level, right, down = plane
    height, width = level.shape
    border = int(steps[-1])
    unit = 1.0 / border
    sums = np.zeros((9, height, width), np.float32)
    gap, weight = (np.empty((height, width), np.float32) for _ in range(2))
    for dy in steps:
        for dx in steps:
            x, y = float(dx * unit), float(dy * unit)
            near = around[border + dy : border + dy + height, border + dx : border + dx + width]
            np.subtract(near, level, out=gap)
            cv2.scaleAdd(right, -x, gap, dst=weight)
            cv2.scaleAdd(down, -y, weight, dst=weight)
            weight *= 1.0 / tolerance
            np.multiply(weight, weight, out=weight)
            np.subtract(1.0, weight, out=weight)
            np.maximum(weight, 0.0, out=weight)
            gap *= weight
            for number, (value, factor) in enumerate(
                ((weight, 1.0), (weight, x), (weight, y), (weight, x * x), (weight, x * y), (weight, y * y),
                 (gap, 1.0), (gap, x), (gap, y))
            ):  # fmt: skip
                if factor:
                    cv2.scaleAdd(value, factor, sums[number], dst=sums[number])
    return sums


def _solve(sums: Array, before: Array) -> Array:
    """Solve the normal equations for planes; if underdetermined, return the previous planes."""
    n, sx, sy, xx, xy, yy, sv, xv, yv = sums
    n = np.maximum(n, 1e-6)
    mx, my, mv = sx / n, sy / n, sv / n
    # Regularize slightly: along a depth edge the slope across it is unknown, and assumed flat.
    cxx, cxy, cyy = xx / n - mx * mx + 0.01, xy / n - mx * my, yy / n - my * my + 0.01
    cxv, cyv = xv / n - mx * mv, yv / n - my * mv
    det = np.maximum(cxx * cyy - cxy * cxy, 1e-6)
    slope_x, slope_y = (cyy * cxv - cxy * cyv) / det, (cxx * cyv - cxy * cxv) / det
    moved = before[0] + mv - slope_x * mx - slope_y * my
    return np.where(n > 3.0, np.stack([moved, slope_x, slope_y]), before)


def surface_normals(inverse_depth: Array, right: Array, down: Array, rays: Array) -> Array:
    """Return unit normals (height x width x 3, float32) in the camera's frame, facing the camera.

    With w = a + right * x + down * y and rays (x', y', 1) of the pixels, the plane n . X = d has
    n / d = gradient of w along the rays.
    """
    per_x = right / max(float(rays[0, 0, 1] - rays[0, 0, 0]), 1e-12)
    per_y = down / max(float(rays[1, 1, 0] - rays[1, 0, 0]), 1e-12)
    along = inverse_depth - per_x * rays[0] - per_y * rays[1]
    normal = -np.stack([per_x, per_y, along], axis=-1)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.asarray(normal / np.maximum(length, 1e-12), np.float32)
