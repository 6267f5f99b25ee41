"""What the disk still tells of a burst that was interrupted, or lacks images."""

from dataclasses import dataclass
from pathlib import Path
from typing import Self

from capture_app.errors import SimulshotError
from capture_app.node.burst.camera_progress import CameraProgress
from capture_app.session.format.manifest import MissingImage
from capture_app.session.reading.reader import Session
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.sync.rig.frame_picks import Burst


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
