"""What a session keeps of a burst: its plan, to be finished by after a crash, and its manifest."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from capture_app.errors import BadInputError, SimulshotError
from capture_app.node.burst.camera_share import CameraShare
from capture_app.session.format.burst_plan import BurstPlan, InstantRange
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.manifest import BurstRecord, MissingImage
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verdict import skipped_text
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.sync.rig.frame_selection import Burst
from capture_app.text import count

Lost = dict[tuple[str, int], MissingImage]
"""By camera and instant, what an earlier run of the leader did not get, or lost, and why."""


def plan_of(
    burst: Burst, writer: SessionWriter, leader: int, note: str, pins: Mapping[str, str]
) -> BurstPlan:
    """The plan of a new burst, by the run of its leader; `note` is for the manifest, `pins` by camera."""
    return BurstPlan(
        name=writer.name,
        created=writer.created,
        software=writer.software,
        leader=leader,
        number=burst.number,
        burst=burst_record(burst),
        cameras=(),
        pins={name: pin for name, pin in pins.items() if pin},
        spare=burst.spare,
        note=note,
    )


def check_machine(plan: BurstPlan, camera: str, pin: str) -> None:
    """Raise BadInputError for a camera's part that is another machine's to bring; nobody has an empty pin."""
    if pin and plan.pins.get(camera, pin) != pin:
        raise BadInputError(
            f"{camera} of {plan.name} is another machine's camera",
            hint="only the machine that took part in the burst can bring its pictures",
        )


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


def burst_of(plan: BurstPlan) -> Burst:
    """The burst that a plan is of."""
    instants_ns, requested_ns = plan.instants_ns, plan.burst.requested_ns
    return Burst(
        plan.number,
        instants_ns,
        plan.burst.period_ns,
        instants_ns[0] if requested_ns is None else requested_ns,
        tuple(told.camera.name for told in plan.cameras),
        plan.spare,
        streamed=plan.streamed is not None,
        video=plan.streamed is not None and plan.streamed.video,
    )


def lost_images(writer: SessionWriter, shares: Iterable[CameraShare]) -> Lost:
    """What the session of an earlier run lacks by its own account. Blocks on the disk.

    Where that was finished no camera is waited for any more; what it gave up may still come.
    """
    reason = "its file was damaged or lost after it came"
    lost = {
        (camera, instant): MissingImage(camera=camera, instant=instant, reason=reason)
        for camera, instant in writer.damaged
    }
    try:
        missing = Session.open(writer.folder).stored_manifest.missing
    except SimulshotError:
        return lost
    for share in shares:
        share.given_up = next((gap.reason for gap in missing if gap.camera == share.name), "it never came")
        share.silent = True
    return lost | {(gap.camera, gap.instant): gap for gap in missing}


def write_manifest(
    writer: SessionWriter,
    shares: Mapping[str, CameraShare],
    burst: BurstRecord,
    missing: Sequence[MissingImage],
) -> Path:
    """Finish a session with what has come, and return its folder. Blocks on the disk.

    Raises BadInputError where the records contradict each other, DiskFullError.
    """
    plans = {name: share.plan for name, share in shares.items()}
    calibrated = {name: of.calibration for name, of in plans.items() if of.calibration is not None}
    if calibrated:
        writer.set_calibration(Calibration(cameras=calibrated, source="the simulated scene"))
    writer.set_ground_truth_clocks({n: of.true_clock for n, of in plans.items() if of.true_clock is not None})
    origin = "simulated" if writer.knows_true_times else "captured"
    note = "" if writer.plan is None else writer.plan.note
    return writer.finish([of.camera for of in plans.values()], burst, missing, origin, note).folder


def result_text(burst: BurstRecord, missing: Sequence[MissingImage]) -> str:
    """What a burst lacks and what was skipped, in a line; empty where neither is anything."""
    told = ""
    if missing:
        reasons = sorted({f"{gap.camera}: {gap.reason}" for gap in missing})
        told = f"{count(len(missing), 'image')} missing ({'; '.join(reasons)})"
    return "; ".join(filter(None, (told, skipped_text(burst.skipped))))
