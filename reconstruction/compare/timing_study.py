"""How late one camera of a pair is, and whether the cameras stood still: what comparisons rest on."""

from itertools import pairwise

import numpy as np

from reconstruction.calibration.rig import Rig
from reconstruction.scores.timing import Timing, judge_timing
from reconstruction.session.camera_motion import measure_camera_motion
from reconstruction.time_offsets.pair_offset import ImageTimes, PairOffsets

MAX_INSTANTS = 32
"""More than depth takes: they cost little, and the error bar is over instants."""


def measure_timing(rig: Rig, cameras: tuple[str, str]) -> Timing:
    """Measure how late the second camera is against the first, at instants at which something moves."""
    data = rig.dataset
    first, second = cameras
    spacing_ms = min((b - a for a, b in pairwise(data.instants_ns)), default=data.period_ns) / 1e6
    motions = {name: measure_camera_motion(data, name) for name in cameras}
    moving = {
        name: found.px * spacing_ms / found.ms for name, found in motions.items() if found and found.moves
    }
    # Before a camera that moves, all that it sees does so too.
    fit = PairOffsets(rig, all_moves=bool(moving)).measure(first, second, MAX_INSTANTS)
    times = ImageTimes(data, cameras)
    apart = [times.middle_ms(second, k) - times.middle_ms(first, k) for k in data.instants(*cameras)]
    return judge_timing(cameras, fit, float(np.median(apart or [0.0])), spacing_ms, moving)
