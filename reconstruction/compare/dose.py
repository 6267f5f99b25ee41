"""`reconstruct dose`: how much delay of one camera the motion of a burst tolerates."""

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import msgspec

from capture_app.errors import BadInputError
from capture_app.terminal import Progress
from reconstruction.calibration.rig import Rig
from reconstruction.common.native_libraries import library_versions
from reconstruction.common.output_folder import comparison_folder, write_metrics
from reconstruction.compare.dose_curve import measure_curve, whole_frame_offsets
from reconstruction.report.dose_report import write_dose_report
from reconstruction.scores.dose_results import DoseResult
from reconstruction.session.conditions import DEFAULT_OFFSET_MS
from reconstruction.session.dataset import Dataset


@dataclass(frozen=True, kw_only=True)
class DoseOptions:
    """Options of a dose curve; the pair is names of cameras, None = chosen from the images."""

    max_offset_ms: float = DEFAULT_OFFSET_MS
    stereo: tuple[str, str] | None = None
    max_instants: int = 16


def dose(session: Path, out: Path | None, options: DoseOptions) -> DoseResult:
    """Measure a pair's depth against offset; write curve, numbers and report to `out` where it is given.

    Raises:
        SimulshotError: the session, the options or the folder cannot be used, or no depth can be made.
    """
    if out is None:
        with tempfile.TemporaryDirectory(prefix="simulshot-") as scratch:
            return _dose(session, Path(scratch) / "stages", options)
    with comparison_folder(out) as output:
        result = _dose(session, output.folder / "stages", options)
        result = msgspec.structs.replace(result, report="report.html")
        write_dose_report(result, output.folder)
        write_metrics(output.folder, result)
    return result


def _dose(session: Path, stages: Path, options: DoseOptions) -> DoseResult:
    began = time.monotonic()
    dataset = Dataset.open(session)
    steps = whole_frame_offsets(dataset, options.max_offset_ms)
    rig = Rig(dataset, stages, steps[-1].step)
    rig.check_pair(options.stereo)
    progress = Progress(3)
    progress.step("calibration")
    rig.calibrate()
    progress.step("choosing cameras")
    choice = rig.choose_stereo_pair(options.stereo, steps[-1].pairs[len(steps[-1].pairs) // 2][0])
    if choice.cameras is None:
        raise BadInputError(f"no depth can be made from {session}: {choice.why}")
    try:
        curve = measure_curve(rig, choice.cameras, steps, options.max_instants, progress)
    except ValueError as error:
        raise BadInputError(f"{choice.cameras[0]} and {choice.cameras[1]}: {error}") from error
    progress.last("curve")
    return msgspec.structs.replace(
        curve,
        session=str(session),
        reason=choice.why,
        calibration=rig.source,
        seconds=time.monotonic() - began,
        versions=library_versions(),
    )
