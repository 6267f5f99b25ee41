"""A cubic spline through space that fits the rays of many frames, each at its own time."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from reconstruction.common.geometry import Array

ROUNDS = 8
"""Rounds of reweighting, by the depth of each ray's point and by its residual."""
CAUCHY = 2.5
"""Residual, in standard deviations, at which a ray has half its weight."""
OUTLIER = 5.0
"""Residual, in standard deviations, from which on a ray is not of the path."""
FLOOR_PX = 0.02
"""Smallest standard deviation of a pixel's coordinate."""
WEAK = 1e-4
"""Weight of bends against rays: as little as is needed where no ray determines the path."""
FOLDS = 8
"""Every eighth moment is left out in turn, to see how well the others predict it."""
FINER = 0.87
"""Ratio of the spacings of knots that are tried."""


@dataclass(frozen=True, eq=False)
class Rays:
    """Rays of frames: times (n,), s; projections (n, 3, 4) and pixels (n, 2) without distortion."""

    times_s: Array
    projections: Array
    pixels: Array

    def choose(self, chosen: Array) -> "Rays":
        """Return some of the rays, by a mask or by indices."""
        return Rays(self.times_s[chosen], self.projections[chosen], self.pixels[chosen])


@dataclass(frozen=True, eq=False)
class SplinePath:
    """A uniform cubic spline: control points (m, 3), and their covariance (3m, 3m) for residuals of 1 px.

    `pixel` is the size of a pixel at the object.
    """

    begin_s: float
    knot_s: float
    control: Array
    covariance: Array
    pixel: float

    def at(self, times_s: Array) -> Array:
        """Return positions (n, 3)."""
        return np.asarray(self._basis(times_s) @ self.control)

    def sd_at(self, times_s: Array) -> Array:
        """Return the standard deviation (n,) of positions along the least certain direction, per px.

        It is at least a pixel: rays of a motion that the spline cannot follow are off together.
        """
        rows = np.kron(self._basis(times_s), np.eye(3)).reshape(len(times_s), 3, -1)
        spreads = np.einsum("nij,jk,nlk->nil", rows, self.covariance, rows)
        return np.sqrt(np.maximum(np.linalg.eigvalsh(spreads)[:, -1], self.pixel**2))

    def residuals_px(self, rays: Rays) -> Array:
        """Return the distances (n,) of the path's points from the rays' pixels."""
        points = np.column_stack([self.at(rays.times_s), np.ones(len(rays.times_s))])
        seen = np.einsum("nij,nj->ni", rays.projections, points)
        depth = np.where(np.abs(seen[:, 2]) < 1e-9, 1e-9, seen[:, 2])
        return np.asarray(np.linalg.norm(seen[:, :2] / depth[:, None] - rays.pixels, axis=1))

    def _basis(self, times_s: Array) -> Array:
        return basis(times_s, self.begin_s, self.knot_s, len(self.control))


def basis(times_s: Array, begin_s: float, knot_s: float, number: int) -> Array:
    """Return the values (n, number) of uniform cubic B-splines."""
    place = np.clip((times_s - begin_s) / knot_s, 0, number - 3 - 1e-9)
    first = np.floor(place).astype(int)
    u = place - first
    weights = np.stack([(1 - u) ** 3, 3 * u**3 - 6 * u**2 + 4, 1 + 3 * u + 3 * u**2 - 3 * u**3, u**3], 1) / 6
    values = np.zeros((len(times_s), number))
    for k in range(4):
        values[np.arange(len(times_s)), first + k] += weights[:, k]
    return values


def fit_path(rays: Rays, begin_s: float, end_s: float, knot_s: float) -> SplinePath:
    """Fit a path with this spacing of knots to rays, least squares of pixels, robust to outliers."""
    number = max(4, int(np.ceil((end_s - begin_s) / knot_s)) + 3)
    values = basis(rays.times_s, begin_s, knot_s, number)
    pixels = rays.pixels
    equations = rays.projections[:, :2] - pixels[:, :, None] * rays.projections[:, 2:]
    left = (values[:, None, :, None] * equations[:, :, None, :3]).reshape(len(values), 2, -1)
    right = -equations[:, :, 3]
    bend = np.diff(np.eye(number), 2, axis=0)
    bends = np.kron(bend.T @ bend, np.eye(3))
    scale = float(np.median(np.linalg.norm(equations[:, 0, :3], axis=1)))
    depth, weight = np.ones(len(values)), np.ones(len(values))
    control: Array = np.zeros(0)
    normal: Array = np.zeros(0)
    for _ in range(ROUNDS):
        weights = np.sqrt(weight) / depth
        rows = (left * weights[:, None, None]).reshape(2 * len(values), -1)
        normal = rows.T @ rows + (WEAK * scale / float(np.median(depth))) ** 2 * bends
        control = np.linalg.solve(normal, rows.T @ (right * weights[:, None]).ravel()).reshape(-1, 3)
        points = np.column_stack([values @ control, np.ones(len(values))])
        seen = np.einsum("nij,nj->ni", rays.projections, points)
        depth = np.maximum(seen[:, 2], 0.05 * max(float(np.median(seen[:, 2])), 1e-9))
        residual = np.linalg.norm(seen[:, :2] / depth[:, None] - pixels, axis=1)
        weight = 1 / (1 + (residual / (CAUCHY * max(_scatter(residual), FLOOR_PX))) ** 2)
    return SplinePath(begin_s, knot_s, control, np.linalg.inv(normal), float(np.median(depth)) / scale)


def choose_path(rays: Rays, moments: Array) -> tuple[SplinePath, float]:
    """Fit the path whose spacing of knots predicts left-out moments best; `moments` (n,) are numbered.

    Returns it with the standard deviation, px, of the coordinates of left-out rays.
    """
    begin_s, end_s = float(rays.times_s.min()), float(rays.times_s.max())
    step_s = (end_s - begin_s) / max(1, int(moments.max()))
    errors: dict[float, float] = {}
    knot_s = best = (end_s - begin_s) / 2
    while knot_s > step_s:
        left_out = [np.empty(0)]
        for fold in range(FOLDS):
            tested = moments % FOLDS == fold
            if tested.any() and not tested.all():
                path = fit_path(rays.choose(~tested), begin_s, end_s, knot_s)
                left_out.append(path.residuals_px(rays.choose(tested)))
        errors[knot_s] = _scatter(np.concatenate(left_out))
        best = min(errors, key=lambda knot: errors[knot])
        knot_s *= FINER
    return fit_path(rays, begin_s, end_s, best), max(errors[best], FLOOR_PX)


def _scatter(distances_px: Sequence[float] | Array) -> float:
    """Return the standard deviation of a coordinate, from the median of distances (Rayleigh)."""
    return float(np.median(distances_px)) / 1.1774
