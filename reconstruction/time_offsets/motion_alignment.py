"""Offsets and rates of recordings without common times: from the amount of motion, then moving points."""

import numpy as np

from capture_app.console.terminal import Progress
from capture_app.session.alignment.clock_line import chain_cameras, fit_clock_line
from capture_app.session.format.common_times import CameraTimes
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.scene import Scene
from reconstruction.time_offsets.camera_time import ImageTimes
from reconstruction.time_offsets.crossings import SYSTEMATIC_MS, OffsetFit
from reconstruction.time_offsets.pair_offset import PairOffsets
from reconstruction.time_offsets.rig_offsets import MOTION, likely_pairs


def align_cameras(scene: Scene, progress: Progress) -> dict[str, CameraTimes]:
    """Measure each camera's times relative to the first camera's, starting from the session's times.

    The times of a camera have an offset or a reason.
    """
    pairs, offsets = {frozenset(pair) for pair in likely_pairs(scene)}, PairOffsets(scene)

    def against(first: str, second: str) -> CameraTimes:
        """Measure the second camera's times relative to the first's."""
        if frozenset((first, second)) not in pairs:
            return CameraTimes(reason="its view overlaps with no camera whose offset is known")
        progress.step(f"{second} against {first}")
        if (fit := offsets.measure_anywhere(first, second)).offset_ms is None:
            return CameraTimes(reason=fit.reason)
        return _line(scene.dataset, first, second, fit)

    return chain_cameras(scene.dataset.cameras, against)


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
