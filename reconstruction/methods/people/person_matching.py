"""Which tracks of several cameras are one individual: by epipolar distances of all joints over time."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from reconstruction.common.geometry import Array, View
from reconstruction.methods.people.joint_tracks import RELIABLE, PixelsAt, Track, size_of
from reconstruction.time_offsets.pair_geometry import epipolar_errors_px

MAX_DISTANCE = 0.042
"""Largest epipolar distance of one individual's tracks, relative to its size in the images."""
MIN_SHARED = 4
"""Fewest joints, over all times, by which two tracks are compared."""


def match_tracks(tracks: Sequence[Track], seen: Sequence[PixelsAt], views: Sequence[View]) -> list[list[int]]:
    """Return the individuals, each as the numbers of its tracks, those of the most frames first.

    `seen` is where the tracks are at some common times, `views` are the cameras'. Groups of tracks are merged
    by average distance, the nearest first; a camera never has an individual twice in a frame.
    """
    sums = _distances(tracks, seen, views)
    counts, sums = np.isfinite(sums).astype(float), np.nan_to_num(sums)
    groups = {place: [place] for place in range(len(tracks))}
    # A track shares its frames with itself, too.
    apart = np.array([[a.camera == b.camera and (a.frames & b.frames).any() for b in tracks] for a in tracks])
    while groups:
        mean = np.where((counts > 0) & ~apart, sums / np.maximum(counts, 1), np.inf)
        first, second = (int(index) for index in np.unravel_index(int(mean.argmin()), mean.shape))
        if mean[first, second] > MAX_DISTANCE:
            break
        groups[first] += groups.pop(second)
        for matrix in (sums, counts, apart):
            matrix[first] += matrix[second]
            matrix[:, first] += matrix[:, second]
        apart[second], apart[:, second] = True, True
    return sorted(groups.values(), key=lambda group: -sum(int(tracks[n].frames.sum()) for n in group))


def _distances(tracks: Sequence[Track], seen: Sequence[PixelsAt], views: Sequence[View]) -> Array:
    """Return the median epipolar distance of each two tracks of different cameras, relative to their sizes.

    NaN where they share too few joints.
    """
    costs = np.full((len(tracks), len(tracks)), np.nan)
    for first, second in combinations(range(len(tracks)), 2):
        one, other = seen[first], seen[second]
        both = (one.confidence > RELIABLE) & (other.confidence > RELIABLE)
        if tracks[first].camera != tracks[second].camera and both.sum() >= MIN_SHARED:
            a, b = (views[tracks[number].camera].undistorted for number in (first, second))
            away = epipolar_errors_px(a, b, one.pixels[both], other.pixels[both])
            size = np.minimum(size_of(one.pixels), size_of(other.pixels))[np.nonzero(both)[0]]
            costs[first, second] = costs[second, first] = float(np.median(np.abs(away) / size))
    return costs
