"""Tracks of joints in one camera's images, each frame at its own time, and where a joint was at any time."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.methods.people.keypoints import CameraJoints, FrameJoints

MIN_CONFIDENCE = 0.3
"""Confidence below which a joint counts as not seen."""
MAX_STEP = 0.35
"""Largest mean step of joints between two frames, relative to the size of the individual."""
AMBIGUOUS = 2.0
"""Ratio of two steps below which it is open who is who: both tracks end."""
MAX_GAP = 2.5
"""Longest time between two frames that is interpolated, in periods: a gap of one frame."""
EDGE = 0.25
"""Longest time outside of a track, in periods, over which its last two frames are extrapolated."""
CURVED = 0.35
"""Standard deviation of an interpolation, relative to the difference between cubic and linear."""
RELIABLE = 0.5
"""Confidence from which on a joint tells who is who."""


FramePlaces = dict[int, tuple[FrameJoints, int]]
"""An individual's place among those of each frame, by instant."""


@dataclass(eq=False)
class Track:
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
    """Return the diagonal (n,) of the box around joints (n, joints, 2), px; NaN where none is known."""
    known = np.isfinite(pixels)
    high = np.where(known, pixels, -np.inf).max(axis=1)
    low = np.where(known, pixels, np.inf).min(axis=1)
    size = np.linalg.norm(high - low, axis=1)
    return np.where(np.isfinite(size), size, np.nan)


def follow_in_camera(joints: CameraJoints, frames: int) -> list[tuple[Array, Array]]:
    """Return the pixels and confidences, (frames, joints, ...), of each individual in a camera's frames.

    An individual keeps its name, or is the nearest of the next frame; where that is open, its track ends.
    """
    tracks, by_name = list[FramePlaces](), dict[str, FramePlaces]()
    for instant, frame in sorted(joints.items()):
        for place, name in enumerate(frame.names):
            by_name.setdefault(name, {})[instant] = frame, place
        if not frame.names:
            _continue(tracks, instant, frame)
    followed = list[tuple[Array, Array]]()
    for track in [*by_name.values(), *tracks]:
        number = next(iter(track.values()))[0].pixels.shape[1]
        pixels, confidence = np.full((frames, number, 2), np.nan), np.zeros((frames, number))
        for instant, (frame, place) in track.items():
            seen = frame.confidence[place] >= MIN_CONFIDENCE
            pixels[instant, seen] = frame.pixels[place, seen]
            confidence[instant, seen] = frame.confidence[place, seen]
        followed.append((pixels, confidence))
    return followed


def _continue(tracks: list[FramePlaces], instant: int, frame: FrameJoints) -> None:
    """Append a frame's individuals to the tracks that they continue, and begin tracks for the others."""
    number = len(frame.pixels)
    open_tracks = [track for track in tracks if max(track) >= instant - 2]
    steps = np.full((len(open_tracks), number), np.inf)
    for row, track in enumerate(open_tracks):
        last, place = track[max(track)]
        shared = (last.confidence[place] > RELIABLE) & (frame.confidence > RELIABLE)
        apart = np.linalg.norm(frame.pixels - last.pixels[place], axis=2)
        size = float(size_of(last.pixels[place][None])[0])
        counted = shared.sum(axis=1)
        mean = np.where(shared, apart, 0).sum(axis=1) / np.maximum(counted, 1) / max(size, 1.0)
        steps[row] = np.where(
            (counted >= min(3, frame.confidence.shape[1])) & (mean < MAX_STEP), mean, np.inf
        )
    free = set(range(number))
    while steps.size and np.isfinite(steps.min()):
        row, place = (int(index) for index in np.unravel_index(int(steps.argmin()), steps.shape))
        rivals = steps < AMBIGUOUS * max(steps[row, place], 1e-3)
        same_place, same_row = rivals[:, place].copy(), rivals[row].copy()
        is_open = same_place.sum() + same_row.sum() > 2
        steps[same_place if is_open else row] = np.inf
        steps[:, same_row if is_open else place] = np.inf
        if is_open:
            continue
        open_tracks[row][instant] = frame, place
        free.discard(place)
    tracks.extend({instant: (frame, place)} for place in sorted(free))


def interpolate(track: Track, at_s: Array, period_s: float, *, nearest: bool = False) -> PixelsAt:
    """Return where a track's joints were at times (n,), by the times of the frames around each.

    Cubic through four frames where they follow each other, else linear; a joint is unknown where more than
    one frame is missing. `nearest` takes the nearest frame as it is, within half a period.
    """
    number = track.pixels.shape[1]
    found = PixelsAt(
        np.full((len(at_s), number, 2), np.nan), *(np.zeros((len(at_s), number)) for _ in range(5))
    )
    for joint in range(number):
        known = np.nonzero(np.isfinite(track.pixels[:, joint, 0]))[0]
        if not len(known):
            continue
        times, pixels = track.times_s[known, joint], track.pixels[known, joint]
        right = np.clip(np.searchsorted(times, at_s), 1, max(len(times) - 1, 1)) % len(times)
        left = np.maximum(right - 1, 0)
        closest = np.where(np.abs(times[left] - at_s) <= np.abs(times[right] - at_s), left, right)
        away = np.abs(times[closest] - at_s)
        if nearest:
            usable = away <= period_s
            weights = np.ones((len(at_s), 1))
            places, bend = closest[:, None], np.zeros(len(at_s))
        else:
            outside = (at_s < times[left]) | (at_s > times[right])
            usable = (
                (left < right)
                & (times[right] - times[left] <= MAX_GAP * period_s)
                & (~outside | (away <= EDGE * period_s))
            )
            usable |= away < 1e-9
            places, weights, bend = _weights(times, pixels, at_s, left, right, closest, period_s)
        confidence = track.confidence[known, joint]
        at = (weights[:, :, None] * pixels[places]).sum(axis=1)
        step = times[right] - times[left]
        speed = np.linalg.norm(pixels[right] - pixels[left], axis=1) / np.where(step > 0, step, np.inf)
        certain = np.minimum(confidence[left], confidence[right])
        moved = np.linalg.norm(at - pixels[closest], axis=1)
        values = PixelsAt(at, certain, (weights**2).sum(axis=1), bend, speed, moved)
        for whole, own in zip(found, values, strict=True):
            whole[usable, joint] = own[usable]
    return found


def _weights(
    times: Array, pixels: Array, at_s: Array, left: Array, right: Array, closest: Array, period_s: float
) -> tuple[Array, Array, Array]:
    """Return four frames (n, 4), their weights, and the standard deviation of the interpolation, px.

    The weights are Lagrange's; linear where the outer frames are missing, and beyond a track's ends.
    """
    before, after = np.maximum(left - 1, 0), np.minimum(right + 1, len(times) - 1)
    places = np.stack([before, left, right, after], axis=1)
    nodes = times[places]
    gaps = np.diff(nodes, axis=1)
    cubic = ((gaps > 0) & (gaps <= MAX_GAP * period_s)).all(axis=1)
    weights = np.ones((len(at_s), 4))
    with np.errstate(divide="ignore", invalid="ignore"):
        for i in range(4):
            for j in range(4):
                if i != j:
                    weights[:, i] *= (at_s - nodes[:, j]) / (nodes[:, i] - nodes[:, j])
        share = np.where(right > left, (at_s - times[left]) / (times[right] - times[left]), 0.0)
    linear = np.stack([np.zeros_like(share), 1 - share, share, np.zeros_like(share)], axis=1)
    cubic &= (share >= 0) & (share <= 1)
    weights = np.where(cubic[:, None], weights, linear)
    at, straight = ((one[:, :, None] * pixels[places]).sum(axis=1) for one in (weights, linear))
    turn = np.linalg.norm(at - np.where(cubic[:, None], straight, pixels[closest]), axis=1)
    bend = turn * CURVED / np.sqrt(2)
    return places, weights, bend


def stack(found: Sequence[PixelsAt]) -> PixelsAt:
    """Return the pixels of several tracks as arrays whose first axis are the tracks."""
    return PixelsAt(*(np.stack(parts) for parts in zip(*found, strict=True)))
