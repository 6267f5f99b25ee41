"""Local planes of a depth map: in inverse depth a plane of the scene is a plane over the pixels."""

import cv2
import numpy as np

from reconstruction.common.geometry import Array

BAND = 32


def fit_planes(
    inverse_depth: Array,
    tolerance: float,
    *,
    slopes: tuple[Array, Array] | None = None,
    radius: int = 2,
    stride: int = 1,
    rounds: int = 2,
) -> tuple[Array, Array, Array]:
    """Inverse depth and its slope per pixel in x and y (float32 height x width) of each pixel's own plane.

    Fitted by least squares to the neighbours within `radius * stride` px that lie within `tolerance` of the
    plane found before, so that no plane bridges an edge of depth; the first plane goes through the
    pixel's own depth and has these `slopes`, or none.
    """
    border = radius * stride
    # What lies beyond the picture is on no plane.
    padded = cv2.copyMakeBorder(
        inverse_depth, border, border, border, border, cv2.BORDER_CONSTANT, value=(-1e6,)
    )
    unit = 1.0 / border
    flat = np.zeros_like(inverse_depth)
    slopes = (slopes[0] / unit, slopes[1] / unit) if slopes else (flat, flat)
    found = tuple(np.empty_like(inverse_depth) for _ in range(3))
    steps = np.arange(-radius, radius + 1, dtype=int) * stride
    # A band of rows at a time stays in the processor's cache.
    for top in range(0, len(inverse_depth), BAND):
        band = slice(top, top + BAND)
        plane = inverse_depth[band], slopes[0][band], slopes[1][band]
        around = padded[top : top + BAND + 2 * border]
        for _ in range(rounds):
            plane = _solve(_weighed(around, plane, steps, tolerance), *plane)
        for whole, part in zip(found, plane, strict=True):
            whole[band] = part
    return found[0], found[1] * np.float32(unit), found[2] * np.float32(unit)


def _weighed(around: Array, plane: tuple[Array, Array, Array], steps: Array, tolerance: float) -> Array:
    """Sums for the normal equations (9, height, width) over the neighbours, by how near the plane they lie.

    `around` holds the inverse depths of a band with a border; of the neighbours' places and their gaps to
    the plane's level: n, x, y, xx, xy, yy, gap, x gap, y gap.
    """
    level, right, down = plane
    height, width = level.shape
    border = int(steps[-1])
    unit = 1.0 / border
    sums = np.zeros((9, height, width), np.float32)
    gap, kept = (np.empty((height, width), np.float32) for _ in range(2))
    for dy in steps:
        for dx in steps:
            x, y = float(dx * unit), float(dy * unit)
            near = around[border + dy : border + dy + height, border + dx : border + dx + width]
            np.subtract(near, level, out=gap)
            cv2.scaleAdd(right, -x, gap, dst=kept)
            cv2.scaleAdd(down, -y, kept, dst=kept)
            kept *= 1.0 / tolerance
            np.multiply(kept, kept, out=kept)
            np.subtract(1.0, kept, out=kept)
            np.maximum(kept, 0.0, out=kept)
            gap *= kept
            for number, (value, factor) in enumerate(
                ((kept, 1.0), (kept, x), (kept, y), (kept, x * x), (kept, x * y), (kept, y * y),
                 (gap, 1.0), (gap, x), (gap, y))
            ):  # fmt: skip
                if factor == 1.0:
                    sums[number] += value
                elif factor:
                    cv2.scaleAdd(value, factor, sums[number], dst=sums[number])
    return sums


def _solve(sums: Array, level: Array, right: Array, down: Array) -> tuple[Array, Array, Array]:
    """Least-squares planes by their normal equations; where these are underdetermined, the planes before."""
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


def surface_normals(inverse_depth: Array, right: Array, down: Array, rays: Array) -> Array:
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
