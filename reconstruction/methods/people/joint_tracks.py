"""Tracks of joints in one camera's images, each frame at its own time, and where a joint was at any time."""

from collections.abc import Sequence
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
    """Return the diagonal (n,) of the box around joints (n, joints, 2), px; NaN where none is known."""
    known = np.isfinite(pixels)
    sides = np.where(known, pixels, -np.inf).max(axis=1) - np.where(known, pixels, np.inf).min(axis=1)
    return np.where(known.any(axis=(1, 2)), np.linalg.norm(sides, axis=1), np.nan)


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
    number, joints = frame.confidence.shape
    open_tracks = [track for track in tracks if max(track) >= instant - 2]
    steps = np.full((len(open_tracks), number), np.inf)
    for row, track in enumerate(open_tracks):
        last, place = track[max(track)]
        shared = (last.confidence[place] > RELIABLE) & (frame.confidence > RELIABLE)
        apart = np.linalg.norm(frame.pixels - last.pixels[place], axis=2)
        size = max(float(size_of(last.pixels[place][None])[0]), 1.0)
        mean = np.where(shared, apart, 0).sum(axis=1) / np.maximum(shared.sum(axis=1), 1) / size
        usable = (shared.sum(axis=1) >= min(3, joints)) & (mean < MAX_STEP)
        steps[row, usable] = mean[usable]
    while np.isfinite(steps).any():
        row, place = (int(index) for index in np.unravel_index(int(steps.argmin()), steps.shape))
        rivals = steps < AMBIGUOUS * max(steps[row, place], 1e-3)
        rows, places = np.flatnonzero(rivals[:, place]), np.flatnonzero(rivals[row])
        if len(rows) == len(places) == 1:
            open_tracks[row][instant] = frame, place
        steps[rows] = steps[:, places] = np.inf
    followed = {track[instant][1] for track in open_tracks if instant in track}
    tracks.extend({instant: (frame, place)} for place in range(number) if place not in followed)


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
        away = np.abs(times[closest] - at_s)
        usable = (step <= MAX_GAP * period_s) & ((np.abs(along - 0.5) <= 0.5) | (away <= EDGE * period_s))
        if nearest:
            along, usable = along.clip(0, 1).round(), away <= period_s
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
        usable |= away < 1e-9
        for whole, own in zip(found, values, strict=True):
            whole[usable, joint] = own[usable]
    return found


def stack(found: Sequence[PixelsAt]) -> PixelsAt:
    """Return the pixels of several tracks as arrays whose first axis are the tracks."""
    return PixelsAt(*(np.stack(parts) for parts in zip(*found, strict=True)))
