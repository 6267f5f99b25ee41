"""How late the cameras are, and whether they stood still: what comparisons rest on."""

from collections.abc import Sequence
from functools import cached_property
from itertools import pairwise

import numpy as np

from reconstruction.calibration.rig import Rig
from reconstruction.scores.timing import RigTiming, Timing, judge_timing, without_common_times
from reconstruction.session.camera_motion import CameraMotion, measure_camera_motion
from reconstruction.time_offsets.crossings import OffsetFit
from reconstruction.time_offsets.pair_offset import ImageTimes, PairOffsets
from reconstruction.time_offsets.rig_offsets import measure_rig_offsets

MAX_INSTANTS = 32
"""Instants of a pair: more than depth takes, as they cost little, and the error bar is over instants."""
RIG_IMAGES = 240
"""Images of all cameras together: the more there are, the fewer instants of each pair."""
RIG_INSTANTS = 6, 24


class TimingStudy:
    """The timing of a calibrated rig, each image's points found once."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.dataset = rig.dataset
        times = self.dataset.instants_ns
        self._spacing_ms = min((b - a for a, b in pairwise(times)), default=self.dataset.period_ns) / 1e6
        self._motions: dict[str, CameraMotion | None] = {}

    def measure_pair(self, cameras: tuple[str, str]) -> Timing:
        """How late the second camera is against the first, at instants at which something moves."""
        finder = self._moved if self._moving(cameras) else self._stood
        return self._judge(cameras, finder.measure(*cameras, MAX_INSTANTS))

    def measure_rig(self, reference: str | None) -> RigTiming:
        """How late every camera is, from many pairs' offsets; against `reference` if that tells most."""
        names = self.dataset.cameras
        least, most = RIG_INSTANTS
        found = measure_rig_offsets(
            self.rig,
            preferred=reference,
            max_instants=min(most, max(least, RIG_IMAGES // len(names))),
            finder=self._moved if self._moving(names) else self._stood,
        )
        first = next(name for name, one in found.items() if one.sd_ms == 0)
        judged = (
            self._judge((first, name), OffsetFit(one.offset_ms, one.sd_ms, one.reason))
            for name, one in found.items()
            if name != first
        )
        return RigTiming(reference=first, cameras=tuple(judged))

    @cached_property
    def _stood(self) -> PairOffsets:
        return PairOffsets(self.rig)

    @cached_property
    def _moved(self) -> PairOffsets:
        """Before a camera that moves, all that it sees does so too."""
        return PairOffsets(self.rig, all_moves=True)

    def _moving(self, cameras: Sequence[str]) -> dict[str, float]:
        """The cameras that move while they record, and by how many px from frame to frame."""
        for name in cameras:
            if name not in self._motions:
                self._motions[name] = measure_camera_motion(self.dataset, name)
        found = ((name, self._motions[name]) for name in cameras)
        return {name: one.px * self._spacing_ms / one.ms for name, one in found if one and one.moves}

    def _judge(self, cameras: tuple[str, str], fit: OffsetFit) -> Timing:
        first, second = cameras
        times = ImageTimes(self.dataset, cameras)
        apart = [
            times.middle_ms(second, k) - times.middle_ms(first, k) for k in self.dataset.instants(*cameras)
        ]
        apart_ms = float(np.median(apart or [0.0]))
        timing = judge_timing(cameras, fit, apart_ms, self._spacing_ms, self._moving(cameras))
        doubt = self.dataset.unsynchronized
        return without_common_times(timing, doubt) if doubt else timing
