"""What a session keeps of a burst under way, to be read and finished after a crash, and its manifest."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import msgspec

from capture_app.errors import SimulshotError
from capture_app.node.burst.camera_progress import CameraProgress
from capture_app.node.wire.messages import CameraReport
from capture_app.session.format.burst_plan import BurstPlan, CameraPlan
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.manifest import BurstRecord, CameraRecord, MissingImage
from capture_app.session.reading.reader import Session
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.sync.rig.frame_picks import Burst


def write_manifest(
    writer: SessionWriter,
    progress: Mapping[str, CameraProgress],
    burst: BurstRecord,
    missing: Sequence[MissingImage],
) -> Path:
    """Finish a session with what has come, and return its folder. Blocks on the disk.

    Raises BadInputError where the records contradict each other, DiskFullError.
    """
    reports = {name: of.report for name, of in progress.items() if of.report is not None}
    calibrated = {n: r.calibration for n, r in reports.items() if r.calibration is not None}
    if calibrated:
        writer.set_calibration(Calibration(cameras=calibrated, source="the simulated scene"))
    writer.set_ground_truth_clocks({n: r.true_clock for n, r in reports.items() if r.true_clock is not None})
    cameras = [of.report.camera if of.report else of.camera for of in progress.values()]
    origin = "simulated" if writer.knows_true_times else "captured"
    note = "" if writer.plan is None else writer.plan.note
    return writer.finish(cameras, burst, missing, origin, note).folder


def burst_record(burst: Burst) -> BurstRecord:
    """The manifest's record of a burst."""
    return BurstRecord(
        instants_ns=burst.instants_ns, period_ns=burst.period_ns, requested_ns=burst.requested_ns
    )


def first_plan(
    writer: SessionWriter,
    leader: int,
    number: int,
    burst: BurstRecord,
    cameras: Iterable[CameraRecord],
    note: str = "",
) -> BurstPlan:
    """What a session is to become, before any camera has reported."""
    return BurstPlan(
        name=writer.name,
        created=writer.created,
        software=writer.software,
        leader=leader,
        number=number,
        burst=burst,
        cameras=tuple(CameraPlan(camera=camera) for camera in cameras),
        note=note,
    )


def add_report(plan: BurstPlan, report: CameraPlan) -> BurstPlan:
    """A plan to which one of its cameras has reported."""
    name = report.camera.name
    cameras = tuple(report if camera.camera.name == name else camera for camera in plan.cameras)
    return msgspec.structs.replace(plan, cameras=cameras)


def camera_plan(report: CameraReport) -> CameraPlan:
    """What a session keeps of a camera's report: all but its events."""
    return CameraPlan(
        camera=report.camera,
        reported=True,
        instants=report.instants,
        missing=report.missing,
        calibration=report.calibration,
        true_clock=report.true_clock,
    )


@dataclass(frozen=True, slots=True)
class InterruptedBurst:
    """A burst as an earlier run left it, and the writer to go on with."""

    burst: Burst
    writer: SessionWriter
    cameras: dict[str, CameraProgress]
    lost: dict[tuple[str, int], MissingImage]
    """Images that an earlier finish gave up, and why."""

    @classmethod
    def read(cls, folder: Path, heard_ns: int) -> Self:
        """Lock a session and read it; its cameras count as heard at `heard_ns`. Blocks on the disk.

        Raises BadInputError where it has no plan, TryAgainError where another process writes it.
        """
        writer = SessionWriter.resume(folder)
        plan = writer.plan
        assert plan is not None
        instants_ns, requested_ns = plan.burst.instants_ns, plan.burst.requested_ns
        burst = Burst(
            plan.number,
            instants_ns,
            plan.burst.period_ns,
            instants_ns[0] if requested_ns is None else requested_ns,
            tuple(told.camera.name for told in plan.cameras),
        )
        cameras = {}
        for told in plan.cameras:
            name = told.camera.name
            has = (writer.image(name, instant) is not None for instant in range(len(instants_ns)))
            there = {instant for instant, is_there in enumerate(has) if is_there}
            report = told if told.reported else None
            cameras[name] = CameraProgress(told.camera, heard_ns, report=report, instants=there)
        reason = "its file was damaged or lost after it came"
        lost = {
            (camera, instant): MissingImage(camera=camera, instant=instant, reason=reason)
            for camera, instant in writer.damaged
        }
        return cls(burst, writer, cameras, lost | _given_up(folder, cameras))


def _given_up(folder: Path, cameras: dict[str, CameraProgress]) -> dict[tuple[str, int], MissingImage]:
    """Of a session that was finished before, wait for no camera; what it gave up may still come."""
    try:
        missing = Session.open(folder).manifest.missing
    except SimulshotError:
        return {}
    for name, camera in cameras.items():
        camera.given_up = next((gap.reason for gap in missing if gap.camera == name), "it never came")
        camera.silent = True
    return {(gap.camera, gap.instant): gap for gap in missing}
