"""Time offsets of the cameras, and whether the cameras stood still: the basis of comparisons."""

from itertools import pairwise

import numpy as np

from reconstruction.calibration.calibrated_rig import Rig
from reconstruction.scores.timing import RigTiming, Timing, judge_timing, without_common_times
from reconstruction.time_offsets.crossings import OffsetFit
from reconstruction.time_offsets.pair_offset import ImageTimes, PairOffsets
from reconstruction.time_offsets.rig_offsets import measure_rig_offsets


class TimingStudy:
    """Timing of a calibrated rig; the points of each image are detected once."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.dataset = rig.dataset
        times = self.dataset.instants_ns
        self._spacing_ms = min((b - a for a, b in pairwise(times)), default=self.dataset.period_ns) / 1e6
        self.offsets = PairOffsets(rig)

    def measure_pair(self, cameras: tuple[str, str]) -> Timing:
        """Measure the second camera's time offset against the first, at instants with motion."""
        return self._judge(cameras, self.offsets.measure(*cameras))

    def measure_rig(self, reference: str | None) -> RigTiming:
        """Measure every camera's time offset from many pairs; prefer `reference` if most informative."""
        found = measure_rig_offsets(self.rig, preferred=reference, finder=self.offsets)
        first = next(name for name, one in found.items() if one.sd_ms == 0)
        judged = (
            self._judge((first, name), OffsetFit(one.offset_ms, one.sd_ms, one.reason))
            for name, one in found.items()
            if name != first
        )
        return RigTiming(reference=first, cameras=tuple(judged))

    def _judge(self, cameras: tuple[str, str], fit: OffsetFit) -> Timing:
        first, second = cameras
        times = ImageTimes(self.dataset, cameras)
        apart = [
            times.middle_ms(second, k) - times.middle_ms(first, k) for k in self.dataset.instants(*cameras)
        ]
        apart_ms = float(np.median(apart or [0.0]))
        moving = {
            name: one.px * self._spacing_ms / one.ms for name, one in self.offsets.moving(cameras).items()
        }
        timing = judge_timing(cameras, fit, apart_ms, self._spacing_ms, moving)
        problem = self.dataset.unsynchronized
        return without_common_times(timing, problem) if problem else timing
