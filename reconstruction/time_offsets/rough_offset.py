"""About how late one camera is against another, however much: by how much moves before each, and when."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.session.dataset import Dataset

SIDE_PX = 160
"""Pictures are made this small: what is asked is only how much changes."""
STEPS = 3.0
"""Steps of a period."""
LEAST_OVERLAP_S = 1.0
CANDIDATES = 8
APART_STEPS = 4


@dataclass(frozen=True)
class Activity:
    """How much moved before a camera (n,) at times (n,) in ms: grey levels a pixel changes by within 1 ms."""

    times_ms: Array
    change: Array

    def at(self, times_ms: Array) -> Array:
        """The logarithm of it at other times; NaN outside."""
        logs = np.log(self.change + 0.1 * float(np.median(self.change)) + 1e-9)
        return np.interp(times_ms, self.times_ms, logs, left=np.nan, right=np.nan)


def measure_activity(dataset: Dataset, camera: str) -> Activity:
    """What changes from each of a camera's images to its next, in the middle between their times."""
    there = dataset.instants(camera)
    epoch_ns = dataset.instants_ns[0]
    before: Array | None = None
    times, changes, last_ms = [], [], 0.0
    for instant in there:
        image = dataset.grey(camera, instant)
        scale = SIDE_PX / max(image.shape)
        small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA).astype(np.float32)
        at_ms = (dataset.record(camera, instant).leader_ns - epoch_ns) / 1e6
        if before is not None:
            difference = np.abs(small - before)
            # A light that is switched is no motion.
            difference = np.clip(difference - np.median(difference), 0, None)
            times.append((at_ms + last_ms) / 2)
            changes.append(float(difference.mean()) / (at_ms - last_ms))
        before, last_ms = small, at_ms
    return Activity(np.array(times), np.array(changes))


def rough_offsets_ms(first: Activity, second: Activity, period_ms: float) -> Sequence[float]:
    """Offsets that bring the second's times to the first's so that both are busy together, the best first."""
    step = period_ms / STEPS
    if min(len(first.times_ms), len(second.times_ms)) < 8:
        return []
    a, b = (of.at(np.arange(of.times_ms[0], of.times_ms[-1], step)) for of in (first, second))
    least = max(round(LEAST_OVERLAP_S * 1e3 / step), min(len(a), len(b)) // 3)
    lags = np.arange(-(len(b) - least), len(a) - least + 1)
    fits = np.array([_correlation(a, b, int(lag)) for lag in lags])
    chosen: list[float] = []
    for k in np.argsort(-fits):
        if fits[k] <= 0 or len(chosen) == CANDIDATES:
            break
        offset = float(first.times_ms[0] - second.times_ms[0] + lags[k] * step)
        if all(abs(offset - other) > APART_STEPS * step for other in chosen):
            chosen.append(offset)
    return chosen


def _correlation(a: Array, b: Array, lag: int) -> float:
    """Of what overlaps when b begins `lag` steps after a; what is long counts for more."""
    begin, end = max(0, lag), min(len(a), lag + len(b))
    if end - begin < 2:
        return -1.0
    x, y = a[begin:end], b[begin - lag : end - lag]
    x, y = x - x.mean(), y - y.mean()
    size = float(np.linalg.norm(x) * np.linalg.norm(y))
    if size == 0:
        return -1.0
    return float(x @ y) / size * float(np.sqrt(end - begin))
