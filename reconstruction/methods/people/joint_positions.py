"""Positions of joints from the pixels of several cameras, with the covariance of each."""

import warnings
from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import cv2
import numpy as np

from reconstruction.common.geometry import Array, View
from reconstruction.methods.people.joint_tracks import PixelsAt, size_of

OUTLIER = 4.0
"""Residual, in standard deviations, from which on a camera is left out of a joint."""
LOST = 0.73
"""Variance of a position relative to the inverse of its weights, which residuals reduce; by simulation."""
STEPS = 4
SINGULAR = 1e-12
"""Part of the weights that is added to them, so that one camera alone moves a point across its ray only."""
QUANTILE_95 = 1.645
"""Of the normal distribution, one-sided."""
JACKKNIFE = 3.0
"""Variance by the jackknife, relative to the expected one, from which on it is believed where all cameras
agree: of three or four cameras it varies itself. On a real film the errors of positions by three and four
cameras then hold 94 and 95 %, 92 and 94 % without it."""
NOISE_ROUNDS = 4
AROUND = 4
"""Times before and after one whose positions say which cameras to believe."""
FIRST_NOISE = 0.012
"""Standard deviation of a pixel before residuals show it, relative to the size of the individual."""
MIN_RESIDUALS = 20
"""Number of positions from which on a joint has a noise of its own."""


class Person(NamedTuple):
    """One individual at all times: positions (times, joints, 3), NaN = unknown, in the calibration's unit.

    `error` is the radius that holds the true position in 95 % of cases, `residual_px` the root mean square
    distance of the pixels from the position's, weighted as the position is, and `cameras` the number
    that it is from; each (times, joints).
    """

    positions: Array
    error: Array
    residual_px: Array
    cameras: Array


class Positions(NamedTuple):
    """Points (n, 3), NaN where no two cameras agree; their covariance (n, 3, 3), and what they came from."""

    points: Array
    covariance: Array
    misfit: Array
    """Sum of squared residuals (n,) of the cameras that it is from, each relative to its variance."""
    residual_px: Array
    """Root mean square distance (n,) of their pixels, weighted as the position is."""
    cameras: Array
    """Number (n,) of cameras that a point is from."""


def locate(projections: Array, pixels: Array, variances: Array, start: Array | None = None) -> Positions:
    """Return the positions that fit pixels (cameras, n, 2) best, by their variances (cameras, n), px squared.

    `projections` are (cameras, 3, 4), of pixels without distortion. Starts from `start` (n, 3), else from the
    pair of cameras that most others agree with; refines by Gauss-Newton with Cauchy weights, and leaves out
    what is farther off than `OUTLIER`.
    """
    seen = np.isfinite(pixels).all(axis=2) & np.isfinite(variances)
    variances = np.where(seen, variances, 1.0)
    pixels = np.where(seen[..., None], pixels, 0.0)
    points = _start(projections, pixels, variances, seen) if start is None else np.nan_to_num(start)
    for step in range(STEPS + 1):
        residuals, jacobian, ahead = project(projections, pixels, points)
        squared = (residuals**2).sum(axis=2) / variances
        weights = np.where(seen & ahead & (squared < OUTLIER**2), 1 / variances / (1 + squared), 0.0)
        weighted = weights[..., None, None] * jacobian
        normal = np.einsum("cnij,cnik->njk", weighted, jacobian)
        total = np.einsum("nii->n", normal)
        scale = np.where(total > 0, SINGULAR * total, 1.0)
        covariance = np.linalg.inv(normal + scale[:, None, None] * np.eye(3))
        if step < STEPS:
            slope = np.einsum("cnij,cni->nj", weighted, residuals)
            points = points + np.einsum("nkj,nj->nk", covariance, slope)
    used = weights > 0
    known = (used.sum(axis=0) >= 2) & (
        np.linalg.det(normal / np.maximum(total, 1e-300)[:, None, None]) > 1e-15
    )
    mean = (weights * squared * variances).sum(axis=0) / np.where(known, weights.sum(axis=0), np.nan)
    return Positions(
        points=np.where(known[:, None], points, np.nan),
        covariance=LOST * covariance,
        misfit=np.where(used & known, squared, 0.0).sum(axis=0),
        residual_px=np.sqrt(mean),
        cameras=np.where(known, used.sum(axis=0), 0),
    )


def locate_with_jackknife(
    projections: Array, pixels: Array, variances: Array, start: Array | None = None
) -> Positions:
    """Return positions as `locate` does, whose covariance also holds what the cameras disagree about.

    It is widened to the variance of the jackknife over all cameras that see a point, also those that
    `locate` left out: where two of three agree by chance, the other pairs are elsewhere.
    """
    located = locate(projections, pixels, variances, start)
    seen = np.isfinite(pixels).all(axis=2) & np.isfinite(variances)
    number, squared = seen.sum(axis=0), np.zeros(pixels.shape[1])
    for camera in range(len(projections)):
        if (points := seen[camera] & (number > 2)).any():
            parts = (np.delete(part, camera, axis=0) for part in (projections, pixels, variances))
            others, their_pixels, their_variances = parts
            moved = locate(others, their_pixels[:, points], their_variances[:, points]).points
            squared[points] += np.nan_to_num(((moved - located.points[points]) ** 2).sum(axis=1))
    jackknife = squared * (number - 1) / np.maximum(number, 1)
    ratio = (
        jackknife / np.einsum("nii->n", located.covariance) / np.where(located.cameras < number, 1, JACKKNIFE)
    )
    return located._replace(covariance=located.covariance * np.maximum(ratio, 1.0)[:, None, None])


def squared_noise(located: Positions, noise: Array) -> Array:
    """Return squares (times, joints) of a pixel's error, px, of positions (times x joints) located by a noise
    (joints,); NaN = unknown.

    The sum of squares of `c` cameras is chi-squared of 2 c - 3 degrees of freedom; each is relative to its
    median, by Wilson and Hilferty.
    """
    freedom = np.maximum(2 * located.cameras - 3, 1)
    expected = freedom * (1 - 2 / (9 * freedom)) ** 3
    ratio = np.where(located.cameras > 0, located.misfit / expected, np.nan)
    return np.asarray(ratio.reshape(-1, len(noise)) * noise**2)


def pixel_noise(squared: Array, pixels: Array) -> Array:
    """Return the standard deviation (joints,) of a pixel of full confidence, px, by squares (n, joints)
    of `squared_noise`.

    Medians are robust to outliers. Without any, it is guessed by the size of individuals' pixels
    (n, joints, 2).
    """
    known = np.isfinite(squared)
    if not known.any():
        sizes = size_of(pixels)
        sizes = sizes[np.isfinite(sizes)]
        return np.full(squared.shape[1], FIRST_NOISE * float(np.median(sizes)) if len(sizes) else 1.0)
    pooled = np.median(squared[known])
    own = [
        np.median(column[rows]) if rows.sum() >= MIN_RESIDUALS else pooled
        for column, rows in zip(squared.T, known.T, strict=True)
    ]
    return np.sqrt(np.maximum(own, 1e-6))


def _start(projections: Array, pixels: Array, variances: Array, seen: Array) -> Array:
    """Return the point (n, 3) of the pair of cameras whose residuals in all cameras are least."""
    number = pixels.shape[1]
    best, points = np.full(number, np.inf), np.zeros((number, 3))
    for a, b in combinations(range(len(projections)), 2):
        homogeneous = cv2.triangulatePoints(projections[a], projections[b], pixels[a].T, pixels[b].T).T
        with np.errstate(divide="ignore", invalid="ignore"):
            place = np.nan_to_num(homogeneous[:, :3] / homogeneous[:, 3:], posinf=0.0, neginf=0.0)
        residuals, _, ahead = project(projections, pixels, place)
        squared = np.where(ahead, (residuals**2).sum(axis=2) / variances, np.inf)
        cost = np.where(seen, np.minimum(squared, OUTLIER**2), 0).sum(axis=0)
        better = seen[a] & seen[b] & (cost < best)
        best[better], points[better] = cost[better], place[better]
    return points


def project(projections: Array, pixels: Array, points: Array) -> tuple[Array, Array, Array]:
    """Return residuals (cameras, n, 2), their Jacobians (cameras, n, 2, 3), and what is ahead of a camera."""
    at, depth = to_pixels(projections, points)
    ahead = depth > 1e-9
    at, depth = np.where(ahead[..., None], at, 0.0), np.where(ahead, depth, 1.0)
    jacobian = projections[:, None, :2, :3] - at[..., None] * projections[:, None, 2:, :3]
    return pixels - at, jacobian / depth[..., None, None], ahead


def to_pixels(projections: Array, points: Array) -> tuple[Array, Array]:
    """Return pixels (..., n, 2) and depths (..., n) of points (..., n, 3) by projections (..., 3, 4)."""
    homogeneous = points @ np.swapaxes(projections[..., :3], -1, -2) + projections[..., None, :, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        return homogeneous[..., :2] / homogeneous[..., 2:], homogeneous[..., 2]


def radius_95(covariance: Array) -> Array:
    """Return the radius (n,) of the sphere around an estimate that holds the truth in 95 % of cases.

    The squared distance is about gamma distributed, its quantile by Wilson and Hilferty (1931).
    """
    mean = np.einsum("nii->n", covariance)
    ninth = 2 * np.einsum("nij,nij->n", covariance, covariance) / (9 * mean**2)
    return np.asarray(np.sqrt(mean * (1 - ninth + QUANTILE_95 * np.sqrt(ninth)) ** 3))


class JointLocator:
    """The cameras of a rig as they locate joints, with the errors that joints share."""

    def __init__(
        self, views: Sequence[View], bias: Array | None, errors_s: Array, scale_error: float = 0.0
    ) -> None:
        """`bias` (joints,): see `detector_bias`, None = 0. `errors_s` (cameras,): sd of their times."""
        self.errors_s, self.scale_error = errors_s, scale_error
        self.bias = np.zeros(1) if bias is None else bias
        self.projections = np.array([view.projection for view in views]).reshape(-1, 3, 4)
        self.middle = np.mean([view.centre for view in views], axis=0)
        self.focal = np.array([view.focal for view in views])
        # A detector errs by a fraction of a person's size: by more pixels in a camera of more pixels.
        self.magnification = (self.focal / np.median(self.focal))[:, None, None]

    def locate_people(self, seen: Sequence[PixelsAt]) -> tuple[list[Person], Array]:
        """Return people by each one's pixels in all cameras, and the noise (joints,) that these show."""
        noise = self.noise(seen)
        return [self._in_time(person, noise) for person in seen], noise

    def locate(self, seen: PixelsAt, noise: Array) -> Positions:
        """Locate all joints at all times by a noise (joints,), px, of a camera of median focal length."""
        return locate(*self.measured(seen, noise))

    def measured(self, seen: PixelsAt, noise: Array) -> tuple[Array, Array, Array]:
        """Return projections, pixels and their variances, as `locate` takes them."""
        confident = seen.confidence > 0
        detected = seen.noise * (noise * self.magnification / np.where(confident, seen.confidence, 1.0)) ** 2
        late = seen.speed * self.errors_s[:, None, None]
        variances = np.where(confident, detected + seen.bend**2 + late**2, np.inf)
        cameras = len(self.projections)
        return self.projections, seen.pixels.reshape(cameras, -1, 2), variances.reshape(cameras, -1)

    def noise(self, seen: Sequence[PixelsAt]) -> Array:
        """Return the standard deviation (joints,) of a pixel of full confidence, as residuals show it, px.

        It is that of a camera of the median focal length; in the others it is in proportion to theirs.
        """
        joints = seen[0].confidence.shape[-1]
        pixels = np.concatenate([person.pixels.reshape(-1, joints, 2) for person in seen])
        noise = pixel_noise(np.full((1, joints), np.nan), pixels)
        for _ in range(NOISE_ROUNDS):
            squared = [squared_noise(self.locate(person, noise), noise) for person in seen]
            noise = pixel_noise(np.concatenate(squared), pixels)
        return noise

    def _in_time(self, seen: PixelsAt, noise: Array) -> Person:
        shape, measured = seen.confidence.shape[1:], self.measured(seen, noise)
        # Where cameras disagree, those are believed that agree with the times around.
        first = locate(*measured).points
        near = _running_median(first.reshape(*shape, 3)).reshape(-1, 3)
        lost = np.isnan(locate(*measured, near).points)
        return self.person(locate_with_jackknife(*measured, np.where(lost, first, near)), shape)

    def person(self, located: Positions, shape: tuple[int, ...]) -> Person:
        """Return the person (times, joints); its errors are by pixels, the detector and the scale."""
        outward, points = located.points - self.middle, located.points.reshape(*shape, 3)
        covariance = located.covariance + self.scale_error**2 * outward[:, :, None] * outward[:, None]
        size = float(np.nanmedian(size_of(points))) if located.cameras.any() else 0.0
        covariance += (np.broadcast_to(self.bias, shape).ravel() * size)[:, None, None] ** 2 * np.eye(3)
        parts = radius_95(covariance), located.residual_px, located.cameras
        return Person(points, *(part.reshape(shape) for part in parts))


def _running_median(points: Array) -> Array:
    """Return the medians (times, joints, 3) of known points over `AROUND` times before and after each."""
    padded = np.pad(points, ((AROUND, AROUND), (0, 0), (0, 0)), constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * AROUND + 1, axis=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return np.asarray(np.nanmedian(windows, axis=3))
