"""Tracks of joints in one camera's images, each frame at its own time, and where a joint was at any time."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from reconstruction.common.geometry import Array

MIN_CONFIDENCE = 0.3
"""Confidence below which a joint counts as not seen."""
MAX_GAP = 2.5
"""Longest time between two frames that is interpolated, in periods: a gap of one frame."""
EDGE = 0.25
"""Longest time outside of a track, in periods, over which its last two frames are extrapolated."""
CURVED = 0.35
"""Standard deviation of an interpolation, relative to the difference between cubic and linear."""


class Track(NamedTuple):
    """One individual in one camera: pixels (frames, joints, 2), without distortion, and confidences.

    Unseen joints are NaN, with confidence 0. `times_s` (frames, joints) are of each joint's own row.
    """

    camera: int
    times_s: Array
    pixels: Array
    confidence: Array

    @property
    def frames(self) -> Array:
        """The frames in which it is seen, bool (frames,)."""
        return np.asarray(np.isfinite(self.pixels[..., 0]).any(axis=1))


class PixelsAt(NamedTuple):
    """Pixels of a track's joints at some times, (times, joints, 2); NaN where they are unknown.

    `noise` is the variance relative to that of a frame, `bend` the standard deviation of the interpolation,
    px; `speed` is in px/s, `moved` in px from the nearest frame; each (times, joints).
    """

    pixels: Array
    confidence: Array
    noise: Array
    bend: Array
    speed: Array
    moved: Array


def size_of(pixels: Array) -> Array:
    """Return the diagonal (n,) of the box around joints (n, joints, 2 or 3); NaN where none is known."""
    known = np.isfinite(pixels)
    extents = np.where(known, pixels, -np.inf).max(axis=1) - np.where(known, pixels, np.inf).min(axis=1)
    return np.where(known.any(axis=(1, 2)), np.linalg.norm(extents, axis=1), np.nan)


def interpolate(track: Track, at_s: Array, period_s: float, *, nearest: bool = False) -> PixelsAt:
    """Return where a track's joints were at times (n,), by the times of the frames around each.

    Cubic through four frames where they follow each other, else linear; a joint is unknown where more than
    one frame is missing. `nearest` takes the nearest frame as it is, within half a period.
    """
    shape = len(at_s), track.pixels.shape[1]
    found = PixelsAt(np.full((*shape, 2), np.nan), *np.zeros((5, *shape)))
    for joint in range(shape[1]):
        known = np.isfinite(track.pixels[:, joint, 0])
        if not known.any():
            continue
        times, pixels = track.times_s[known, joint], track.pixels[known, joint]
        right = np.searchsorted(times, at_s).clip(min(1, len(times) - 1), len(times) - 1)
        left = np.maximum(right - 1, 0)
        step = np.where(right > left, times[right] - times[left], np.inf)
        along = (at_s - times[left]) / step
        closest = np.where(along <= 0.5, left, right)
        apart_s = np.abs(times[closest] - at_s)
        usable = (step <= MAX_GAP * period_s) & ((np.abs(along - 0.5) <= 0.5) | (apart_s <= EDGE * period_s))
        if nearest:
            along, usable = along.clip(0, 1).round(), apart_s <= period_s
        places = np.stack([left - 1, left, right, right + 1], axis=1).clip(0, len(times) - 1)
        gaps = np.diff(times[places], axis=1)
        cubic = ((gaps > 0) & (gaps <= MAX_GAP * period_s)).all(axis=1) & (along > 0) & (along < 1)
        linear = np.stack([0 * along, 1 - along, along, 0 * along], axis=1)
        weights = linear.copy()
        # Those with which each polynomial of third degree is met.
        powers = ((times[places[cubic]] - at_s[cubic, None]) / period_s)[:, None] ** np.arange(4)[:, None]
        weights[cubic] = np.linalg.solve(powers, np.eye(4)[:, :1])[..., 0]
        at, straight = ((one[..., None] * pixels[places]).sum(axis=1) for one in (weights, linear))
        straight[~cubic] = pixels[closest[~cubic]]
        values = PixelsAt(
            at,
            np.minimum(*track.confidence[known, joint][[left, right]]),
            (weights**2).sum(axis=1),
            np.linalg.norm(at - straight, axis=1) * CURVED / np.sqrt(2),
            np.linalg.norm(pixels[right] - pixels[left], axis=1) / step,
            np.linalg.norm(at - pixels[closest], axis=1),
        )
        usable |= apart_s < 1e-9
        for whole, own in zip(found, values, strict=True):
            whole[usable, joint] = own[usable]
    return found


def stack(found: Sequence[PixelsAt]) -> PixelsAt:
    """Return the pixels of several tracks as arrays whose first axis are the tracks."""
    return PixelsAt(*(np.stack(parts) for parts in zip(*found, strict=True)))
