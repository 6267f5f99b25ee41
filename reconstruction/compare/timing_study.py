"""Time offsets of the cameras, and whether the cameras stood still: the basis of comparisons."""

from itertools import pairwise

import numpy as np

from reconstruction.scores.timing import RigTiming, Timing, judge_timing, without_common_times
from reconstruction.time_offsets.crossings import OffsetFit
from reconstruction.time_offsets.pair_offset import ImageTimes, PairOffsets
from reconstruction.time_offsets.rig_offsets import measure_rig_offsets


def measure_pair_timing(offsets: PairOffsets, cameras: tuple[str, str]) -> Timing:
    """Measure the second camera's time offset against the first, at instants with motion."""
    return _judge(offsets, cameras, offsets.measure(*cameras))


def measure_rig_timing(offsets: PairOffsets, reference: str | None) -> RigTiming:
    """Measure every camera's time offset from many pairs; prefer `reference` if most informative."""
    found = measure_rig_offsets(offsets.rig, preferred=reference, finder=offsets)
    first = next(name for name, one in found.items() if one.sd_ms == 0)
    judged = (
        _judge(
            offsets, (first, name), OffsetFit(one.offset_ms, one.sd_ms, one.reason, misfit_px=one.misfit_px)
        )
        for name, one in found.items()
        if name != first
    )
    return RigTiming(reference=first, cameras=tuple(judged))


def _judge(offsets: PairOffsets, cameras: tuple[str, str], fit: OffsetFit) -> Timing:
    dataset, (first, second) = offsets.dataset, cameras
    instants_ns = dataset.instants_ns
    spacing_ms = min((b - a for a, b in pairwise(instants_ns)), default=dataset.period_ns) / 1e6
    times = ImageTimes(dataset, cameras)
    apart = [times.middle_ms(second, k) - times.middle_ms(first, k) for k in dataset.instants(*cameras)]
    moving = {name: one.px * spacing_ms / one.ms for name, one in offsets.moving(cameras).items()}
    timing = judge_timing(cameras, fit, float(np.median(apart or [0.0])), spacing_ms, moving)
    problem = dataset.unsynchronized
    return without_common_times(timing, problem) if problem else timing
