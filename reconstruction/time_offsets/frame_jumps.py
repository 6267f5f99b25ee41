"""Place of a dropped or repeated frame, by the changes of each camera's own image from one to the next.

Where nothing crosses between two cameras, their crossings leave a step's place open. What moves changes both
cameras' images alike. After a dropped frame, one camera's images change as later ones of the other do.
"""

from collections.abc import Mapping

import cv2
import numpy as np
from msgspec import structs

from reconstruction.common.geometry import Array
from reconstruction.time_offsets.instant_votes import Step

BESIDE = 4
"""Number of instants before and after a step's range that also count."""
MIN_CHANGES = 6
"""Minimum number of changes of one camera that the other's changes can explain."""
BLUR_PX = 1.5
"""Standard deviation of the blur against noise."""
NOISES = 6.0
"""Multiple of the median difference between two images that is taken as their noise."""
CLEARER_OUTSIDE = 0.5
"""Maximum misfit of a place outside the range, relative to the best one inside."""
CLEARER = 0.9
"""Maximum misfit (1 minus the correlation) of another place, relative to a step's own, to move there."""


def image_change(before: Array, image: Array) -> float:
    """Return an image's (grey, uint8) difference from the one before: mean grey levels beyond noise."""
    old, new = (cv2.GaussianBlur(picture.astype(np.float32), (0, 0), BLUR_PX) for picture in (before, image))
    difference = np.abs(new - old)
    return float(np.maximum(difference - NOISES * np.median(difference), 0).mean())


def place_step(step: Step, first: Mapping[int, float], second: Mapping[int, float], shift: int = 0) -> Step:
    """Return the step at the place in or beside its range where the second camera's changes fit best.

    A step of no frames if they fit far better without one: then none was dropped or repeated.

    `first`, `second`: each camera's `image_change` by instant, around the step. `shift`: frames by which the
    second camera is later before the step.
    """
    inside = range(step.earliest, step.latest + 1)
    # Where motion turns, crossings mislead: two instants outside the range are possible too.
    beside = range(max(step.earliest - 2, 1), step.latest + 2 + 1)
    near = [k for k in second if step.earliest - BESIDE <= k <= step.latest + BESIDE]

    def misfit(place: int) -> float:
        def shown(k: int) -> int:
            return k + shift if k < place else max(place - 1 + shift, k + shift + step.frames)

        spans = {k: range(shown(k - 1) + 1, shown(k) + 1) for k in near}
        known = [k for k, span in spans.items() if all(j in first for j in span)]
        changes = np.array([[second[k], sum(first[j] for j in spans[k])] for k in known]).T
        if len(known) < MIN_CHANGES or not changes.std(axis=1).all():
            return np.inf
        return 1 - float(np.corrcoef(changes)[0, 1])

    if misfit(max(near, default=0) + 1) < CLEARER_OUTSIDE * min(map(misfit, beside)) < np.inf:
        return structs.replace(step, frames=0)
    misfits = {place: misfit(place) for place in {*inside, *beside, step.instant}}
    best, other = (min(places, key=misfits.__getitem__) for places in (inside, beside))
    if misfits[other] < CLEARER_OUTSIDE * misfits[best]:
        best = other
    if misfits[best] >= CLEARER * misfits[step.instant]:
        return step
    earliest, latest = min(step.earliest, best), max(step.latest, best)
    return structs.replace(step, instant=best, earliest=earliest, latest=latest)
