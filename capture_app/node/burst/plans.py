"""What a session keeps of a burst under way, to be read and finished after a crash, and its manifest."""

import asyncio
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import msgspec

from capture_app.errors import SimulshotError
from capture_app.node.burst.camera_progress import CameraProgress
from capture_app.node.burst.disk_threads import DiskThreads
from capture_app.node.burst.instant_choice import InstantChoice
from capture_app.node.wire.messages import CameraReport
from capture_app.session.format.burst_plan import BurstPlan, CameraPlan, InstantRange
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.manifest import BurstRecord, MissingImage
from capture_app.session.reading.reader import Session
from capture_app.session.reading.skipped_instants import skipped_text
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.sync.rig.frame_picks import Burst
from capture_app.text import count


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
    """The record of a burst as it was ordered, without its instants where frames are sent as they come."""
    return BurstRecord(
        instants_ns=() if burst.streamed else tuple(burst.instants_ns),
        period_ns=burst.period_ns,
        requested_ns=burst.requested_ns,
    )


def instant_range(burst: Burst) -> InstantRange | None:
    """The instants of a burst whose frames are sent as they come; None of any other."""
    if not burst.streamed:
        return None
    first_ns, count = burst.instants_ns[0], len(burst.instants_ns)
    step_ns = burst.instants_ns[1] - first_ns if count > 1 else burst.period_ns
    return InstantRange(first_ns=first_ns, step_ns=step_ns, count=count, video=burst.video)


def result_text(burst: BurstRecord, missing: Sequence[MissingImage]) -> str:
    """What a burst lacks and what was skipped, in a line; empty where neither is anything."""
    told = ""
    if missing:
        reasons = sorted({f"{gap.camera}: {gap.reason}" for gap in missing})
        told = f"{count(len(missing), 'image')} missing ({'; '.join(reasons)})"
    return "; ".join(filter(None, (told, skipped_text(burst.skipped))))


class SharedPlan:
    """The plan on disk; what is to be in it while it is being written is written together."""

    def __init__(self, writer: SessionWriter, disk: DiskThreads) -> None:
        self._writer = writer
        self._disk = disk
        self._newest = self._saved = writer.plan
        self._writing = asyncio.Lock()

    def begin(self, leader: int, burst: Burst, note: str) -> None:
        """The burst of a new session, by the run of its leader; `note` is for the manifest."""
        self._newest = BurstPlan(
            name=self._writer.name,
            created=self._writer.created,
            software=self._writer.software,
            leader=leader,
            number=burst.number,
            burst=burst_record(burst),
            cameras=(),
            spare=burst.spare,
            note=note,
            streamed=instant_range(burst),
        )

    def end(self, burst: Burst) -> None:
        """Take note that a burst ends earlier than it was ordered; it is on disk after the next `save`."""
        if self._newest is not None:
            self._newest = msgspec.structs.replace(self._newest, streamed=instant_range(burst))

    async def save(self, cameras: Iterable[CameraPlan], chosen: tuple[int, ...] | None) -> None:
        """Return once what the cameras have told, and the instants of the burst, are on the disk.

        Raises DiskFullError. Without `begin` there is no plan, and nothing is done.
        """
        if self._newest is None:
            return
        self._newest = msgspec.structs.replace(self._newest, cameras=tuple(cameras), chosen=chosen)
        async with self._writing:
            newest = self._newest
            if newest != self._saved:
                await self._disk.call(self._writer.set_plan, newest)
                self._saved = newest


def camera_plan(report: CameraReport, known: CameraPlan | None = None) -> CameraPlan:
    """What a session keeps of a camera's report: all but its events.

    Where an earlier run of the leader knew what the camera was, only what is to come may be told anew.
    """
    if known is not None and known.reported:
        return msgspec.structs.replace(
            known,
            instants=report.instants,
            missing=report.missing,
            picking=report.picking,
            picked=report.picked,
            missing_runs=report.missing_runs,
        )
    return CameraPlan(
        camera=report.camera,
        reported=True,
        instants=report.instants,
        missing=report.missing,
        picking=report.picking,
        picked=report.picked,
        missing_runs=report.missing_runs,
        calibration=report.calibration,
        true_clock=report.true_clock,
    )


@dataclass(frozen=True, slots=True)
class InterruptedBurst:
    """A burst as an earlier run left it, and the writer to go on with."""

    burst: Burst
    writer: SessionWriter
    cameras: dict[str, CameraProgress]
    choice: InstantChoice
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
        instants_ns, requested_ns = plan.instants_ns, plan.burst.requested_ns
        burst = Burst(
            plan.number,
            instants_ns,
            plan.burst.period_ns,
            instants_ns[0] if requested_ns is None else requested_ns,
            tuple(told.camera.name for told in plan.cameras),
            plan.spare,
            streamed=plan.streamed is not None,
            video=plan.streamed is not None and plan.streamed.video,
        )
        choice, cameras = InstantChoice(burst, plan.chosen), {}
        for told in plan.cameras:
            name = told.camera.name
            there = writer.instants_of(name)
            report = told if told.reported else None
            cameras[name] = CameraProgress(told.camera, heard_ns, report=report, instants=there)
        reason = "its file was damaged or lost after it came"
        lost = {
            (camera, instant): MissingImage(camera=camera, instant=instant, reason=reason)
            for camera, instant in writer.damaged
        }
        return cls(burst, writer, cameras, choice, lost | _given_up(folder, cameras))


def _given_up(folder: Path, cameras: dict[str, CameraProgress]) -> dict[tuple[str, int], MissingImage]:
    """Of a session that was finished before, wait for no camera; what it gave up may still come."""
    try:
        missing = Session.open(folder).stored_manifest.missing
    except SimulshotError:
        return {}
    for name, camera in cameras.items():
        camera.given_up = next((gap.reason for gap in missing if gap.camera == name), "it never came")
        camera.silent = True
    return {(gap.camera, gap.instant): gap for gap in missing}
