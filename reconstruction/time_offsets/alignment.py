"""Offsets and rates of the cameras of a recording without common times, by what moves."""

from functools import lru_cache

import numpy as np

from capture_app.session.alignment.chain import chain_cameras
from capture_app.session.alignment.clock_line import Moments, fit_clock_line
from capture_app.session.format.common_times import CameraTimes
from capture_app.terminal import Progress
from reconstruction.calibration.rig import Rig
from reconstruction.time_offsets.offset_fit import SYSTEMATIC_MS, OffsetFit
from reconstruction.time_offsets.pair_offset import ImageTimes, PairOffsets, RoughOffset
from reconstruction.time_offsets.rig_offsets import likely_pairs
from reconstruction.time_offsets.rough_offset import Activity, measure_activity, rough_offsets_ms

REACH_FRAMES = 2.5
"""What a rough offset may be wrong by."""
TRIAL_INSTANTS = 8
MOST_INSTANTS = 60
DISTINCT = 1.5
"""The offset that is right has so many times as many crossings that agree as any other."""
SOURCE = "motion"


class MotionAlignment:
    """The times of a calibrated rig's cameras against each other's, each image's points found once."""

    def __init__(self, rig: Rig, progress: Progress) -> None:
        self.rig = rig
        self.dataset = rig.dataset
        self.progress = progress
        self.offsets = PairOffsets(rig)
        self._pairs = {frozenset(pair) for pair in likely_pairs(rig)}
        self._activity = lru_cache(maxsize=None)(self._measure_activity)

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
            fit = self.offsets.measure(first, second, TRIAL_INSTANTS, rough=RoughOffset(offset_ms, reach_ms))
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
        return RoughOffset(best_ms, 1.5 * period_ms)

    def _line(self, first: str, second: str, fit: OffsetFit) -> CameraTimes:
        times = ImageTimes(self.dataset, (first, second))
        epoch_ms = self.dataset.instants_ns[0] / 1e6
        reference_ms = np.array([times.middle_ms(first, one.instant) for one in fit.instants]) + epoch_ms
        camera_ms = reference_ms - np.array([one.offset_ms for one in fit.instants])
        # What an instant's points share their number does not average out.
        sds_ms = np.array([np.hypot(one.sd_ms, SYSTEMATIC_MS) for one in fit.instants])
        moments = Moments(camera_ms / 1e3, reference_ms / 1e3, sds_ms / 1e3)
        return fit_clock_line(moments, SOURCE, systematic_s=2 * SYSTEMATIC_MS / 1e3)

    def _measure_activity(self, camera: str) -> Activity:
        return measure_activity(self.dataset, camera)
