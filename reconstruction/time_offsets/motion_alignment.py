"""Offsets and rates of a recording without common times: by how much moves, then by points that move."""

from collections.abc import Sequence
from functools import lru_cache, partial

import cv2
import numpy as np

from capture_app.console.terminal import Progress
from capture_app.session.alignment.clock_line import chain_cameras, fit_clock_line
from capture_app.session.format.common_times import CameraTimes
from reconstruction.calibration.rig import Rig
from reconstruction.common.geometry import Array
from reconstruction.session.dataset import Dataset
from reconstruction.time_offsets.crossings import SYSTEMATIC_MS, OffsetFit
from reconstruction.time_offsets.pair_offset import ImageTimes, PairOffsets, RoughOffset
from reconstruction.time_offsets.rig_offsets import MOTION, likely_pairs

SIDE_PX = 160
"""Pictures are made this small: what is asked is only how much changes."""
STEPS = 3.0
"""Steps of a period."""
LEAST_OVERLAP_S = 1.0
CANDIDATES = 8
APART_STEPS = 4


Activity = tuple[Array, Array]
"""Times (n,) ms, and how much moved before a camera then: grey levels that a pixel changes by within 1 ms."""
REACH_FRAMES = 2.5
"""What a rough offset may be wrong by."""
TRIAL_INSTANTS = 8
MOST_INSTANTS = 60
DISTINCT = 1.5
"""The offset that is right has so many times as many crossings that agree as any other."""


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
    return np.array(times), np.array(changes)


def rough_offsets_ms(first: Activity, second: Activity, period_ms: float) -> Sequence[float]:
    """Offsets that bring the second's times to the first's so that both are busy together, the best first."""
    step = period_ms / STEPS
    if min(len(times_ms) for times_ms, _ in (first, second)) < 8:
        return []
    a, b = (
        np.interp(np.arange(times_ms[0], times_ms[-1], step), times_ms, _logarithm(change))
        for times_ms, change in (first, second)
    )
    least = max(round(LEAST_OVERLAP_S * 1e3 / step), min(len(a), len(b)) // 3)
    lags = np.arange(-(len(b) - least), len(a) - least + 1)
    fits = np.array([_correlation(a, b, int(lag)) for lag in lags])
    chosen: list[float] = []
    for k in np.argsort(-fits):
        if fits[k] <= 0 or len(chosen) == CANDIDATES:
            break
        offset = float(first[0][0] - second[0][0] + lags[k] * step)
        if all(abs(offset - other) > APART_STEPS * step for other in chosen):
            chosen.append(offset)
    return chosen


def _logarithm(change: Array) -> Array:
    return np.asarray(np.log(change + 0.1 * float(np.median(change)) + 1e-9))


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


class MotionAlignment:
    """The times of a calibrated rig's cameras against each other's, each image's points found once."""

    def __init__(self, rig: Rig, progress: Progress) -> None:
        self.rig = rig
        self.dataset = rig.dataset
        self.progress = progress
        self.offsets = PairOffsets(rig)
        self._pairs = {frozenset(pair) for pair in likely_pairs(rig)}
        self._activity = lru_cache(maxsize=None)(partial(measure_activity, self.dataset))

    def measure(self) -> dict[str, CameraTimes]:
        """Each camera's times against the first's, by the times of the session."""
        return chain_cameras(self.dataset.cameras, self.against)

    def against(self, first: str, second: str) -> CameraTimes:
        """The times of the second camera against the first's; without an offset, why there is none."""
        if frozenset((first, second)) not in self._pairs:
            return CameraTimes(reason="it looks where no camera does whose offset is known")
        self.progress.total += 1
        self.progress.step(f"{second} against {first}")
        rough = self._rough(first, second)
        if isinstance(rough, str):
            return CameraTimes(reason=rough)
        fit = self.offsets.measure(first, second, MOST_INSTANTS, rough=rough)
        if fit.offset_ms is None:
            return CameraTimes(reason=fit.reason)
        return self._line(first, second, fit)

    def _rough(self, first: str, second: str) -> RoughOffset | str:
        """The offset near which most points agree, of those that make both cameras busy together."""
        period_ms = self.dataset.period_ns / 1e6
        reach_ms = REACH_FRAMES * period_ms
        tried: list[tuple[float, float]] = []
        reason = "how much moves before them is alike at no offset"
        for offset_ms in rough_offsets_ms(self._activity(first), self._activity(second), period_ms):
            fit = self.offsets.measure(first, second, TRIAL_INSTANTS, rough=(offset_ms, reach_ms))
            if fit.offset_ms is None:
                reason = fit.reason
            else:
                tried.append((fit.votes, fit.offset_ms))
        if not tried:
            return reason
        votes, best_ms = max(tried)
        rivals = [other for other, at_ms in tried if abs(at_ms - best_ms) > period_ms]
        if votes < DISTINCT * max(rivals, default=0.0):
            return "the points that move agree on several offsets"
        return best_ms, 1.5 * period_ms

    def _line(self, first: str, second: str, fit: OffsetFit) -> CameraTimes:
        times = ImageTimes(self.dataset, (first, second))
        epoch_ms = self.dataset.instants_ns[0] / 1e6
        reference_ms = np.array([times.middle_ms(first, one.instant) for one in fit.instants]) + epoch_ms
        camera_ms = reference_ms - np.array([one.late_ms for one in fit.instants])
        # What an instant's points share their number does not average out.
        sds_ms = np.array([np.hypot(one.sd_ms, SYSTEMATIC_MS) for one in fit.instants])
        return fit_clock_line(
            camera_ms / 1e3, reference_ms / 1e3, sds_ms / 1e3, MOTION, systematic_s=2 * SYSTEMATIC_MS / 1e3
        )
