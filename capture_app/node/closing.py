"""The end of a burst on disk: what its cameras told becomes the session's manifest."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from capture_app.node.plans import true_clock_of
from capture_app.node.share import Share
from capture_app.session.calibration import Calibration
from capture_app.session.manifest import BurstRecord, MissingImage
from capture_app.session.store import SessionWriter


def write_manifest(
    writer: SessionWriter, shares: Mapping[str, Share], burst: BurstRecord, missing: Sequence[MissingImage]
) -> Path:
    """Finish a session with what has come, and return its folder. Blocks on the disk.

    Raises BadInputError where the records contradict each other, DiskFullError.
    """
    reports = {name: share.report for name, share in shares.items() if share.report is not None}
    calibrated = {n: r.calibration for n, r in reports.items() if r.calibration is not None}
    if calibrated:
        writer.set_calibration(Calibration(cameras=calibrated, source="the simulated scene"))
    writer.set_ground_truth_clocks(
        {name: true for name, report in reports.items() if (true := true_clock_of(report)) is not None}
    )
    cameras = [share.report.camera if share.report else share.camera for share in shares.values()]
    origin = "simulated" if writer.knows_true_times else "captured"
    return writer.finish(cameras, burst, missing, origin).folder
