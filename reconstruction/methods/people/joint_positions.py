"""Positions of joints from the pixels of several cameras, with the covariance of each."""

from itertools import combinations
from typing import NamedTuple

import numpy as np

from reconstruction.common.geometry import Array

OUTLIER = 4.0
"""Residual, in standard deviations, from which on a camera is left out of a joint."""
CAUCHY = 1.0
"""Residual, in standard deviations, at which a camera has half its weight while the position is sought."""
LOST = 0.73
"""Variance of a position relative to the inverse of its weights, which residuals reduce; by simulation."""
STEPS = 4
QUANTILE_95 = 1.645
"""Of the normal distribution, one-sided."""


class Positions(NamedTuple):
    """Points (n, 3), NaN where no two cameras agree; their covariance (n, 3, 3), and what they came from."""

    points: Array
    covariance: Array
    residuals: Array
    """Pixels minus projection (cameras, n, 2), px; NaN for a camera that is left out."""
    residual_px: Array
    """Root mean square of their lengths (n,), weighted as the position is."""
    used: Array
    """Cameras (cameras, n), bool, that a point is from."""


def locate(projections: Array, pixels: Array, variances: Array, start: Array | None = None) -> Positions:
    """Return the positions that fit pixels (cameras, n, 2) best, by their variances (cameras, n), px squared.

    `projections` are (cameras, 3, 4), of pixels without distortion. Starts from `start` (n, 3) where it is
    known, else from the pair of cameras that most others agree with; refines by Gauss-Newton, and leaves out
    what is farther off than `OUTLIER`.
    """
    seen = np.isfinite(pixels).all(axis=2) & np.isfinite(variances)
    variances = np.where(seen, np.maximum(variances, 1e-12), 1.0)
    pixels = np.where(seen[..., None], pixels, 0.0)
    points = _start(projections, pixels, variances, seen)
    if start is not None:
        points = np.where(np.isfinite(start), start, points)
    for step in range(STEPS + 1):
        residuals, jacobian, ahead = _project(projections, pixels, points)
        weights = _weights(seen & ahead, variances, residuals)
        normal = np.einsum("cn,cnij,cnik->njk", weights, jacobian, jacobian)
        if step < STEPS:
            points = points + _solve(normal, np.einsum("cn,cnij,cni->nj", weights, jacobian, residuals))
    used = weights > 0
    covariance = LOST * _inverse(normal)
    known = (used.sum(axis=0) >= 2) & np.isfinite(points).all(axis=1)
    known &= np.isfinite(covariance).all(axis=(1, 2))
    used = used & known
    points = np.where(known[:, None], points, np.nan)
    squared = (residuals**2).sum(axis=2)
    mean = (weights * squared).sum(axis=0) / np.where(known, weights.sum(axis=0), 1.0)
    return Positions(points, covariance, np.where(used[..., None], residuals, np.nan), np.sqrt(mean), used)


def _weights(seen: Array, variances: Array, residuals: Array) -> Array:
    """Return the weights (cameras, n) of cameras by their residuals; 0 for outliers."""
    squared = (residuals**2).sum(axis=2) / variances
    weights = 1 / variances / (1 + squared / CAUCHY**2)
    return np.asarray(np.where(seen & (squared < OUTLIER**2), weights, 0.0))


def _start(projections: Array, pixels: Array, variances: Array, seen: Array) -> Array:
    """Return the point (n, 3) of the pair of cameras whose residuals in all cameras are least."""
    number = pixels.shape[1]
    best, points = np.full(number, np.inf), np.zeros((number, 3))
    for a, b in combinations(range(len(projections)), 2):
        both = seen[a] & seen[b]
        if not both.any():
            continue
        rows = [
            pixels[c, both, axis, None] * projections[c, 2] - projections[c, axis]
            for c in (a, b)
            for axis in (0, 1)
        ]
        system = np.stack(rows, axis=1)
        system /= np.linalg.norm(system[..., :3], axis=2, keepdims=True)
        left, right = system[..., :3], -system[..., 3]
        place = _solve(np.einsum("nij,nik->njk", left, left), np.einsum("nij,ni->nj", left, right))
        residuals, _, ahead = _project(projections, pixels[:, both], place)
        squared = np.where(ahead, (residuals**2).sum(axis=2) / variances[:, both], np.inf)
        cost = np.where(seen[:, both], np.minimum(squared, OUTLIER**2), 0).sum(axis=0)
        better = cost < best[both]
        chosen = np.nonzero(both)[0][better]
        best[chosen], points[chosen] = cost[better], place[better]
    return points


def _project(projections: Array, pixels: Array, points: Array) -> tuple[Array, Array, Array]:
    """Return residuals (cameras, n, 2), their Jacobians (cameras, n, 2, 3), and what is ahead of a camera."""
    homogeneous = np.einsum("cij,nj->cni", projections[..., :3], points) + projections[:, None, :, 3]
    ahead = homogeneous[..., 2] > 1e-9
    depth = np.where(ahead, homogeneous[..., 2], 1.0)
    at = homogeneous[..., :2] / depth[..., None]
    jacobian = projections[:, None, :2, :3] - at[..., None] * projections[:, None, 2:, :3]
    return pixels - at, jacobian / depth[..., None, None], ahead


def _solve(normal: Array, right: Array) -> Array:
    return np.asarray(np.einsum("nij,nj->ni", np.nan_to_num(_inverse(normal)), right))


def _inverse(normal: Array) -> Array:
    """Return the inverses of symmetric matrices (n, 3, 3); NaN for those that have none."""
    scale = np.einsum("nii->n", normal)[:, None, None]
    scaled = np.nan_to_num(normal / np.where(scale > 0, scale, np.inf))
    regular = np.linalg.det(scaled) > 1e-15
    inverse = np.full_like(normal, np.nan)
    inverse[regular] = np.linalg.inv(scaled[regular]) / scale[regular]
    return inverse


def radius_95(covariance: Array) -> Array:
    """Return the radius (n,) of the sphere around an estimate that holds the truth in 95 % of cases.

    The squared distance is about gamma distributed, its quantile by Wilson and Hilferty (1931).
    """
    mean = np.einsum("nii->n", covariance)
    variance = 2 * np.einsum("nij,nij->n", covariance, covariance)
    with np.errstate(invalid="ignore", divide="ignore"):
        ninth = variance / (9 * mean**2)
        return np.asarray(np.sqrt(mean * (1 - ninth + QUANTILE_95 * np.sqrt(ninth)) ** 3))
