"""Offsets and rates of recordings without common times: from the amount of motion, then moving points."""

from collections.abc import Sequence
from functools import lru_cache, partial
from itertools import pairwise

import cv2
import numpy as np

from capture_app.console.terminal import Progress
from capture_app.session.alignment.clock_line import chain_cameras, fit_clock_line
from capture_app.session.format.common_times import CameraTimes
from reconstruction.common.geometry import Array
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.scene import Scene
from reconstruction.time_offsets.camera_time import ImageTimes
from reconstruction.time_offsets.crossings import SYSTEMATIC_MS, OffsetFit
from reconstruction.time_offsets.pair_offset import PairOffsets, RoughOffset
from reconstruction.time_offsets.rig_offsets import MOTION, likely_pairs

SIDE_PX = 160
"""Longer side to which images are reduced; only the amount of change matters."""
STEPS = 3.0
"""Resampling steps per frame period."""
MIN_OVERLAP_S = 1.0
CANDIDATES = 8
APART_STEPS = 4


Activity = tuple[Array, Array]
"""Times (n,) ms, and the motion in view of a camera: mean change of a pixel in 1 ms, grey levels."""
MAX_ERROR_FRAMES = 2.5
"""Maximum error of a rough offset, in frame periods."""
TRIAL_INSTANTS = 8
MAX_INSTANTS = 60
DISTINCT = 1.5
"""Minimum ratio of the correct offset's agreeing crossings to those of any other offset."""


def measure_activity(dataset: Dataset, camera: str) -> Activity:
    """Measure the change from each of a camera's images to the next, timed at the middle between them."""
    there = dataset.instants(camera)
    scale = SIDE_PX / max(dataset.size(camera))
    small = (
        cv2.resize(dataset.grey(camera, k), None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        for k in there
    )
    changes = []
    for before, after in pairwise(small):
        difference = cv2.absdiff(before, after).astype(np.float32)
        # Switching a light is not motion.
        changes.append(float(np.clip(difference - np.median(difference), 0, None).mean()))
    times_ms = np.array([dataset.record(camera, k).leader_ns - dataset.instants_ns[0] for k in there]) / 1e6
    return (times_ms[1:] + times_ms[:-1]) / 2, np.array(changes) / np.diff(times_ms)


def rough_offsets_ms(first: Activity, second: Activity, period_ms: float) -> Sequence[float]:
    """Return the offsets (ms) of the second camera at which both activities correlate, best first."""
    step = period_ms / STEPS
    if min(len(times_ms) for times_ms, _ in (first, second)) < 8:
        return []
    a, b = (
        np.interp(
            np.arange(times_ms[0], times_ms[-1], step),
            times_ms,
            np.log(change + 0.1 * np.median(change) + 1e-9),
        )
        for times_ms, change in (first, second)
    )
    min_steps = max(round(MIN_OVERLAP_S * 1e3 / step), min(len(a), len(b)) // 3)
    lags = np.arange(-(len(b) - min_steps), len(a) - min_steps + 1)
    fits = np.array([_correlation(a, b, int(lag)) for lag in lags])
    chosen: list[float] = []
    for k in np.argsort(-fits):
        if fits[k] <= 0 or len(chosen) == CANDIDATES:
            break
        offset = float(first[0][0] - second[0][0] + lags[k] * step)
        if all(abs(offset - other) > APART_STEPS * step for other in chosen):
            chosen.append(offset)
    return chosen


def _correlation(a: Array, b: Array, lag: int) -> float:
    """Return the correlation of the overlap when b begins `lag` steps after a, weighted by its length."""
    begin, end = max(0, lag), min(len(a), lag + len(b))
    if end - begin < 2:
        return -1.0
    x, y = a[begin:end], b[begin - lag : end - lag]
    x, y = x - x.mean(), y - y.mean()
    size = float(np.linalg.norm(x) * np.linalg.norm(y))
    return float(x @ y) / size * float(np.sqrt(end - begin)) if size else -1.0


def align_cameras(scene: Scene, progress: Progress) -> dict[str, CameraTimes]:
    """Measure each camera's times relative to the first camera's, starting from the session's times.

    The times of a camera have an offset or a reason.
    """
    pairs, offsets = {frozenset(pair) for pair in likely_pairs(scene)}, PairOffsets(scene)
    activity = lru_cache(maxsize=None)(partial(measure_activity, scene.dataset))

    def against(first: str, second: str) -> CameraTimes:
        """Measure the second camera's times relative to the first's."""
        if frozenset((first, second)) not in pairs:
            return CameraTimes(reason="its view overlaps with no camera whose offset is known")
        progress.step(f"{second} against {first}")
        rough = _rough_offset(offsets, (first, second), activity(first), activity(second))
        if isinstance(rough, str):
            return CameraTimes(reason=rough)
        if (fit := offsets.measure(first, second, MAX_INSTANTS, rough=rough)).offset_ms is None:
            return CameraTimes(reason=fit.reason)
        if fit.change.steps:
            return CameraTimes(reason=f"{fit.change.describe(second, first)}: it dropped or repeated frames")
        return _line(scene.dataset, first, second, fit)

    return chain_cameras(scene.dataset.cameras, against)


def _rough_offset(
    offsets: PairOffsets, pair: tuple[str, str], first: Activity, second: Activity
) -> RoughOffset | str:
    """Return the candidate offset on which most points agree, or the reason why there is none."""
    period_ms = offsets.dataset.period_ns / 1e6
    max_offset_ms = MAX_ERROR_FRAMES * period_ms
    tried: list[tuple[float, float]] = []
    reason = "the amount of motion in view matches at no offset"
    for offset_ms in rough_offsets_ms(first, second, period_ms):
        fit = offsets.measure(*pair, TRIAL_INSTANTS, rough=(offset_ms, max_offset_ms))
        if fit.offset_ms is None:
            reason = fit.reason
        else:
            tried.append((fit.votes, fit.offset_ms))
    if not tried:
        return reason
    votes, best_ms = max(tried)
    rivals = [other for other, at_ms in tried if abs(at_ms - best_ms) > period_ms]
    distinct = votes >= DISTINCT * max(rivals, default=0.0)
    return (best_ms, 1.5 * period_ms) if distinct else "the moving points fit several offsets"


def _line(dataset: Dataset, first: str, second: str, fit: OffsetFit) -> CameraTimes:
    times = ImageTimes(dataset, (first, second))
    reference_ms = np.array([times.middle_ms(first, instant.instant) for instant in fit.instants]) + (
        dataset.instants_ns[0] / 1e6
    )
    camera_ms = reference_ms - np.array([instant.late_ms for instant in fit.instants])
    # More points do not average out the error that an instant's points share.
    sds_ms = np.array([np.hypot(instant.sd_ms, SYSTEMATIC_MS) for instant in fit.instants])
    return fit_clock_line(
        camera_ms / 1e3, reference_ms / 1e3, sds_ms / 1e3, MOTION, systematic_s=2 * SYSTEMATIC_MS / 1e3
    )
