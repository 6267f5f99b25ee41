"""Cameras whose joints fit another time better than the one that their frames state."""

import warnings
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from capture_app.common.text import duration
from reconstruction.common.geometry import SIGMAS_95, Array
from reconstruction.methods.people.joint_positions import SINGULAR, project
from reconstruction.methods.people.joint_tracks import PixelsAt
from reconstruction.methods.people.people_run import PeopleFinder

MAX_TIMES = 300
"""Times by which cameras are judged, from the first on."""
BLOCKS = 10
"""Parts of the times that are left out in turn: what all of them say varies as much as the error is."""
ROUNDS = 3
MIN_PERIODS, MIN_ERRORS, MIN_S = 0.75, 2.0, 0.0125
"""Least offset that is named: in periods, relative to its 95 % error, and in s, as a detector's bias follows
motion: on a real film that is synchronized it looked like 11 ms in one of four cameras."""
WIDE = 4.0
"""Residuals, in standard deviations of a pixel, that count by half."""
APART = 2
"""Times before and after one by whose positions a joint's speed is known."""


class CameraOffset(NamedTuple):
    """A camera whose frames were taken `late_s` after their stated times, with its 95 % error."""

    name: str
    late_s: float
    error_s: float


def late_cameras(finder: PeopleFinder, times_s: Array) -> list[CameraOffset]:
    """Return the cameras whose joints fit other times than most cameras' do; needs three cameras.

    Least squares over all cameras, joints and times: a pixel is that of a common position, plus its speed
    times the camera's offset. Errors are by the jackknife over blocks of time, as a detector errs alike for
    a while.
    """
    times_s, cameras = times_s[:MAX_TIMES], len(finder.names)
    if len(times_s) < 2 * BLOCKS or cameras < 3:
        return []
    late_s, error_s = np.zeros(cameras), np.zeros(cameras)
    for _ in range(ROUNDS):
        shown = {name: np.full(len(times_s), -late) for name, late in zip(finder.names, late_s, strict=True)}
        seen = finder.pixels_at(times_s, shown)
        noise = finder.locator.noise(seen)
        blocks = np.sum([_normal_equations(finder, frames, noise, times_s) for frames in seen], axis=0)
        late_s = late_s + _solution(blocks.sum(axis=0))
        without = np.array([_solution(np.delete(blocks, k, axis=0).sum(axis=0)) for k in range(BLOCKS)])
        error_s = SIGMAS_95 * np.sqrt((BLOCKS - 1) * without.var(axis=0))
    min_s = np.maximum(max(MIN_PERIODS * finder.period_s, MIN_S), MIN_ERRORS * error_s)
    return [
        CameraOffset(finder.names[k], float(late_s[k]), float(error_s[k]))
        for k in np.flatnonzero(np.abs(late_s) > min_s)
    ]


def describe_late_cameras(finder: PeopleFinder, times_s: Array) -> Iterator[str]:
    """Yield a remark for each camera that `late_cameras` finds."""
    for late in late_cameras(finder, times_s):
        when = "later" if late.late_s > 0 else "earlier"
        yield (
            f"{late.name}'s joints are where the others see them {duration(abs(late.late_s) * 1e9)} {when}"
            f" (± {duration(late.error_s * 1e9)}): its frames' times may be wrong, which is in no error"
        )


def _solution(equations: Array) -> Array:
    """Return the offsets (cameras,), of which most are near 0: what all share is not known."""
    normal, right = equations[:-1, :-1], equations[:-1, -1]
    offsets = np.linalg.pinv(normal, rcond=1e-6, hermitian=True) @ right
    return np.asarray(offsets - np.median(offsets))


def _normal_equations(finder: PeopleFinder, seen: PixelsAt, noise: Array, times_s: Array) -> Array:
    """Return the normal equations (blocks, cameras + 1, cameras + 1) of the offsets, right side last."""
    cameras, times, joints = seen.confidence.shape
    points = finder.locator.locate(seen, noise).points.reshape(times, joints, 3)
    speed = np.full(points.shape, np.nan)
    apart_s = times_s[2 * APART :] - times_s[: -2 * APART]
    speed[APART:-APART] = (points[2 * APART :] - points[: -2 * APART]) / apart_s[:, None, None]
    apart, jacobian, ahead = project(
        finder.locator.projections, seen.pixels.reshape(cameras, -1, 2), points.reshape(-1, 3)
    )
    shape = cameras, times, joints
    along = np.einsum("cnij,nj->cni", jacobian, speed.reshape(-1, 3)).reshape(*shape, 2)
    apart, jacobian = apart.reshape(*shape, 2), jacobian.reshape(*shape, 2, 3)
    known = np.isfinite(apart).all(axis=3) & np.isfinite(along).all(axis=3) & ahead.reshape(shape)
    known &= seen.confidence > 0
    # A detector sees each joint aside in its own way, whatever the motion.
    apart, along = (_less_median(np.where(known[..., None], one, np.nan)) for one in (apart, along))
    weight = np.where(known, 1 / (1 + (apart**2).sum(axis=3) / (WIDE * noise) ** 2), 0.0)
    root = np.sqrt(weight)[..., None]
    steep = np.where(known[..., None, None], jacobian * root[..., None], 0.0)
    rows = np.moveaxis(steep, 0, 2).reshape(times, joints, 2 * cameras, 3)
    moved = np.zeros((times, joints, 2 * cameras, cameras + 1))
    for camera in range(cameras):
        moved[:, :, 2 * camera : 2 * camera + 2, camera] = (root * along)[camera]
    moved[..., cameras] = np.moveaxis(root * apart, 0, 2).reshape(times, joints, 2 * cameras)
    # Without what another position would explain.
    turned = np.swapaxes(rows, 2, 3)
    square = turned @ rows
    tiny = SINGULAR * np.trace(square, axis1=2, axis2=3)[..., None, None] + 1e-30
    moved -= rows @ np.linalg.solve(square + tiny * np.eye(3), turned @ moved)
    block = np.arange(times) * BLOCKS // times
    sums = np.zeros((BLOCKS, cameras + 1, cameras + 1))
    np.add.at(sums, block, (np.swapaxes(moved, 2, 3) @ moved).sum(axis=1))
    return sums


def _less_median(values: Array) -> Array:
    """Return values (cameras, times, joints, 2) without their medians over time; 0 where unknown."""
    with warnings.catch_warnings():
        # Medians of what is unknown throughout.
        warnings.simplefilter("ignore", RuntimeWarning)
        return np.asarray(np.nan_to_num(values - np.nanmedian(values, axis=1, keepdims=True)))
