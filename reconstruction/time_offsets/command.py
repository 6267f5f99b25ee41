"""`reconstruct time`: how late each camera of a session is, by what moves in its pictures."""

import tempfile
import time
from pathlib import Path

from msgspec import Struct

from capture_app.terminal import Progress
from reconstruction.calibration.adoption import adopt_kept_calibration
from reconstruction.calibration.rig import Rig
from reconstruction.session.dataset import Dataset
from reconstruction.time_offsets.rig_offsets import CameraOffset, measure_rig_offsets


class CameraTime(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """How much later than its times say a camera's images were taken, against the reference's; or why not."""

    offset_ms: float | None = None
    sd_ms: float | None = None
    """A standard deviation."""
    source: str = ""
    """What it was measured by."""
    reason: str = ""
    """Why it cannot be told."""


class TimeResult(Struct, frozen=True, kw_only=True):
    """What `reconstruct time` found; `cameras` by name."""

    session: str
    reference: str
    cameras: dict[str, CameraTime]
    calibration: str
    seconds: float


def measure_times(session: Path, reference: str | None = None) -> TimeResult:
    """Measure the time offsets of a session's cameras; nothing is written.

    Raises:
        SimulshotError: the session cannot be used, has no such camera, or its cameras cannot be calibrated.
    """
    began = time.monotonic()
    dataset = Dataset.open(session)
    dataset.require_cameras(2, "an offset is one of two cameras")
    if reference is not None:
        dataset.session.camera(reference)
    adopt_kept_calibration(dataset)
    progress = Progress(2)
    with tempfile.TemporaryDirectory(prefix="simulshot-") as scratch:
        rig = Rig(dataset, Path(scratch))
        progress.step("calibration")
        rig.calibrate()
        found = measure_rig_offsets(rig, reference, progress)
    progress.last("offsets")
    return TimeResult(
        session=str(session),
        reference=next(name for name, one in found.items() if one.sd_ms == 0),
        cameras={name: _camera_time(one) for name, one in found.items()},
        calibration=rig.source,
        seconds=time.monotonic() - began,
    )


def _camera_time(found: CameraOffset) -> CameraTime:
    if found.offset_ms is None or found.sd_ms is None:
        return CameraTime(reason=found.reason)
    if found.sd_ms == 0:
        return CameraTime(offset_ms=0.0, sd_ms=0.0, source="reference")
    source = f"what moves, against {', '.join(found.pairs)}"
    return CameraTime(offset_ms=round(found.offset_ms, 3), sd_ms=round(found.sd_ms, 3), source=source)
