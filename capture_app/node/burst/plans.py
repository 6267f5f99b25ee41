"""What a session keeps of a burst under way, to be read and finished after a crash, and its manifest.

Settling on the instants of a burst by what its cameras tell, on disk before any of them hears of it.
"""

import asyncio
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import msgspec

from capture_app.errors import SimulshotError
from capture_app.node.burst.camera_share import CameraProgress, DiskThreads
from capture_app.node.burst.instant_choice import InstantChoice, Reports
from capture_app.node.wire.messages import CameraReport
from capture_app.session.format.burst_plan import BurstPlan, CameraPlan, InstantRange
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.manifest import BurstRecord, MissingImage
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verdict import skipped_text
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


class Settlement:
    """The choice of one burst's instants, and the plan that it is kept in."""

    def __init__(
        self, choice: InstantChoice, plan: SharedPlan, cameras: Mapping[str, CameraProgress]
    ) -> None:
        self.choice = choice
        self._plan = plan
        self._cameras = cameras
        self._settling = asyncio.Lock()
        self._settled = asyncio.Event()
        if choice.is_settled:
            self._settled.set()

    @property
    def reports(self) -> Reports:
        """What each camera has told."""
        return {name: camera.report for name, camera in self._cameras.items()}

    @property
    def undecided(self) -> list[str]:
        """The cameras that keep the instants from being settled, once any camera has told what it has."""
        if self.choice.is_settled or not any(self.reports.values()):
            return []
        return [name for name, camera in self._cameras.items() if not camera.report and not camera.given_up]

    async def settle(self) -> None:
        """Settle on the instants if that is possible now. Raises DiskFullError; nothing is settled then."""
        async with self._settling:
            if self.choice.is_settled:
                return
            awaited = [camera.report for camera in self._cameras.values() if not camera.given_up]
            chosen = self.choice.find(awaited)
            if chosen is not None:
                await self._save(chosen)
                self.choice.chosen = chosen
                self._settled.set()

    async def save_plan(self) -> None:
        """Put on disk what the cameras have told. Raises DiskFullError."""
        await self._save(self.choice.wanted)

    async def wait(self, timeout_s: float) -> bool:
        """Wait until the instants are settled, at most so long; return whether they are."""
        with suppress(TimeoutError):
            async with asyncio.timeout(timeout_s):
                await self._settled.wait()
        return self.choice.is_settled

    async def _save(self, chosen: tuple[int, ...] | None) -> None:
        shares = [camera.report or CameraPlan(camera=camera.camera) for camera in self._cameras.values()]
        await self._plan.save(shares, chosen)
