"""Approximate offset of a recording without common times, anywhere in its overlap with another."""

from collections.abc import Callable, Sequence
from itertools import pairwise

import cv2
import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.scene.dataset import Dataset
from reconstruction.time_offsets.crossings import OffsetFit

STEPS = 3.0
"""Resampling steps per frame period."""
MIN_IMAGES = 8
"""Minimum number of images that are compared."""


Activity = tuple[Array, Array]
"""Times (n,) ms, and the motion in view of a camera: mean change of a pixel in 1 ms, grey levels."""
RoughOffset = tuple[float, float]
"""Approximate delay of a pair's second camera, and the maximum error of this delay, ms."""
MAX_ERROR_FRAMES = 2.5
"""Maximum error of a rough offset, in frame periods."""
DISTINCT = 1.5
"""Ratio of an offset's agreeing crossings to another's from which the other is not tried again."""
DISTINCT_AT_ONCE = 1.2
"""The same at the same instants, at which a motion that repeats has nearly as many in every period."""
MIN_COMPARED = 6
"""Minimum number of instants at which two offsets are compared."""
REPEATS = 0.5
"""Minimum correlation of the amount of motion with itself, a lag later, for a motion that repeats."""


def reduced_image(dataset: Dataset, camera: str, instant: int) -> Array:
    """Return an image's brightness, uint8, reduced so that its longer side is 160 px."""
    grey = dataset.grey(camera, instant)
    # Only the amount of change matters.
    scale = 160 / max(grey.shape)
    return np.asarray(cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))


def measure_activity(dataset: Dataset, camera: str) -> Activity:
    """Measure the change from each of a camera's images to the next, timed at the middle between them."""
    there = dataset.instants(camera)
    changes = []
    for before, after in pairwise(reduced_image(dataset, camera, k) for k in there):
        difference = cv2.absdiff(before, after).astype(np.float32)
        # Switching a light is not motion.
        changes.append(float(np.clip(difference - np.median(difference), 0, None).mean()))
    times_ms = np.array([dataset.record(camera, k).leader_ns - dataset.instants_ns[0] for k in there]) / 1e6
    return (times_ms[1:] + times_ms[:-1]) / 2, np.array(changes) / np.diff(times_ms)


def rough_offsets_ms(first: Activity, second: Activity, period_ms: float) -> Sequence[float]:
    """Return the offsets (ms) of the second camera at which both activities correlate, best first."""
    step = period_ms / STEPS
    if min(len(times_ms) for times_ms, _ in (first, second)) < MIN_IMAGES:
        return []
    a, b = (_evenly(activity, step) for activity in (first, second))
    # At least a second.
    min_steps = max(round(1e3 / step), min(len(a), len(b)) // 3)
    lags = np.arange(-(len(b) - min_steps), len(a) - min_steps + 1)
    # A correlation over more images is less likely to be chance.
    fits = np.array(
        [correlation * np.sqrt(size) for correlation, size in (_correlation(a, b, int(k)) for k in lags)]
    )
    chosen: list[float] = []
    for k in np.argsort(-fits):
        # Eight candidates, each more than four steps from the others.
        if fits[k] <= 0 or len(chosen) == 8:
            break
        offset = float(first[0][0] - second[0][0] + lags[k] * step)
        if all(abs(offset - other) > 4 * step for other in chosen):
            chosen.append(offset)
    return chosen


def repeats_after_ms(activity: Activity, period_ms: float) -> float | None:
    """Return the time after which the motion of MIN_IMAGES or more repeats, ms; None if it does not."""
    a = _evenly(activity, period_ms / STEPS)
    again = np.array([_correlation(a, a, lag)[0] for lag in range(2 * len(a) // 3)])
    return first_return(again, 0.0, REPEATS) * period_ms / STEPS or None


def first_return(likeness: Array, unlike: float, alike: float) -> int:
    """Return the lag of the first maximum above `alike` after the likeness was below `unlike`; 0 if none is.

    A slow motion is like itself for a while, and what repeats exactly as much at each multiple.
    """
    apart = np.flatnonzero(likeness < unlike)
    again = np.flatnonzero(likeness > alike)
    again = again[again > apart.min(initial=len(likeness))]
    if not len(again):
        return 0
    end = min((k for k in apart if k > again[0]), default=len(likeness))
    return int(again[0] + likeness[again[0] : end].argmax())


def _evenly(activity: Activity, step_ms: float) -> Array:
    """Return the logarithm of the motion, at even times from the first on."""
    times_ms, change = activity
    at_ms = np.arange(times_ms[0], times_ms[-1], step_ms)
    return np.asarray(np.interp(at_ms, times_ms, np.log(change + 0.1 * np.median(change) + 1e-9)))


def _correlation(a: Array, b: Array, lag: int) -> tuple[float, int]:
    """Return the correlation of the overlap when b begins `lag` steps after a, and its length."""
    begin, end = max(0, lag), min(len(a), lag + len(b))
    x, y = a[begin:end], b[begin - lag : end - lag]
    x, y = x - x.mean(), y - y.mean()
    size = float(np.linalg.norm(x) * np.linalg.norm(y))
    return (float(x @ y) / size if size else -1.0), end - begin


def find_rough_offset(
    measure: Callable[..., OffsetFit],
    first: Activity,
    second: Activity,
    repeats_ms: float,
    period_ms: float,
) -> RoughOffset | str:
    """Return the candidate offset on which most points agree, or the reason why there is none.

    `measure` measures the pair's offset near another one. `repeats_ms` is the period of all that moves, or 0:
    parts seem to repeat by chance, and where recordings hardly overlap nothing shows that they do not.
    """
    # The amount of motion repeats each time that a pendulum comes by: twice in a period. What the images
    # show is more accurate.
    lags = [repeats_ms, *(repeats_after_ms(camera, period_ms) for camera in (first, second))]
    equal, reason = equal_offsets(
        measure,
        rough_offsets_ms(first, second, period_ms),
        [n * lag for lag in lags if lag for n in (-2, -1, 1, 2)],
        (first[0], second[0]),
        period_ms,
    )
    if len(equal) > 1:
        listed = ", ".join(f"{ms:+.0f}" for ms in sorted(equal))
        further = f", and others {repeats_ms:.0f} ms apart" if repeats_ms else ""
        return f"the motion repeats: offsets of {listed} ms fit equally{further}"
    return (equal[0], 1.5 * period_ms) if equal else reason


def equal_offsets(
    measure: Callable[..., OffsetFit],
    candidates_ms: Sequence[float],
    beside_ms: Sequence[float],
    times_ms: Sequence[Array],
    period_ms: float,
) -> tuple[Sequence[float], str]:
    """Return the candidate offset on which most points agree, and those that fit equally; or why none does.

    `measure` measures the pair's offset near another one. `beside_ms` is how far from the best one others are
    compared with it, and `times_ms` are when each camera's images were taken.
    """
    fits = [measure(8, rough=(late_ms, MAX_ERROR_FRAMES * period_ms)) for late_ms in candidates_ms]
    tried = [(fit.votes, fit.offset_ms) for fit in fits if fit.offset_ms is not None]
    if not tried:
        return (), fits[-1].reason if fits else "the amount of motion in view matches at no offset"
    votes, best_ms = max(tried)
    rivals = [best_ms + ms for ms in beside_ms]
    rivals += [other_ms for other, other_ms in tried if votes < DISTINCT * other]
    equal = [best_ms]
    for other_ms in rivals:
        if (
            all(abs(other_ms - ms) > period_ms for ms in equal)
            and _overlap_ms(times_ms, other_ms) > MIN_IMAGES * period_ms
            and not _excludes(measure, best_ms, other_ms, period_ms)
        ):
            equal.append(other_ms)
    return equal, ""


def _overlap_ms(times_ms: Sequence[Array], late_ms: float) -> float:
    """Return the time in which both cameras have images if the second has this delay, ms."""
    a, b = times_ms
    return float(min(a[-1], b[-1] + late_ms) - max(a[0], b[0] + late_ms))


def _excludes(measure: Callable[..., OffsetFit], best_ms: float, other_ms: float, period_ms: float) -> bool:
    """Return whether clearly more points agree on one offset than on the other.

    They are compared at up to 24 instants that have images for both, else at each one's own. An offset that
    has too few is not excluded.
    """
    reach_ms = MAX_ERROR_FRAMES * period_ms

    def compared(best_beside_ms: float | None, other_beside_ms: float | None, distinct: float) -> bool | None:
        best, other = (
            measure(24, rough=(near_ms, reach_ms), beside_ms=beside_ms)
            for near_ms, beside_ms in ((best_ms, best_beside_ms), (other_ms, other_beside_ms))
        )
        if min(best.examined, other.examined) < MIN_COMPARED:
            return None
        return best.votes / best.examined > distinct * other.votes / other.examined

    at_once = compared(other_ms, best_ms, DISTINCT_AT_ONCE)
    return bool(compared(None, None, DISTINCT) if at_once is None else at_once)
