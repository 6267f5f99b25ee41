"""`burst.json`: the plan of a burst, on disk before its first image, to finish it by after a crash."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from msgspec import Struct, ValidationError, convert, structs

from capture_app.common.bounds import Count, Positive, Sentence, TimeNs
from capture_app.common.clock import SimulatedClock
from capture_app.common.errors import BadInputError
from capture_app.common.names import Name, check_name
from capture_app.session.files.untrusted_files import read_struct
from capture_app.session.format.calibration import CameraCalibration
from capture_app.session.format.manifest import BurstRecord, CameraRecord, MissingImage, check_written

PLAN = "burst.json"
PLAN_VERSION = 2


class MissingRun(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Instants in a row of which a camera has no frame, all for one reason."""

    first: Count
    count: Count
    reason: Sentence
    dropped: bool = False
    """The camera dropped the frames."""


class InstantRange(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The instants of a burst whose frames are sent as they come, which may be millions; times in ns."""

    first_ns: TimeNs
    step_ns: Positive
    count: Positive
    video: bool = False
    """The frames go into a video for each camera."""


class CameraPlan(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is known of one camera of a burst."""

    camera: CameraRecord
    """With the records of its clock and phase once it has reported."""
    reported: bool = False
    instants: tuple[Count, ...] = ()
    """The images that it has announced."""
    missing: tuple[MissingImage, ...] = ()
    """The images that it has reported missing."""
    picking: bool = False
    """Further frames will be picked and announced."""
    picked: Count | None = None
    """The instant before which all frames that are sent as they come are there or missing."""
    missing_runs: tuple[MissingRun, ...] = ()
    calibration: CameraCalibration | None = None
    true_clock: SimulatedClock | None = None
    """A simulated camera's clock as it really is."""


class BurstPlan(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A burst in progress: its number, its cameras, and what they have reported."""

    name: Name
    created: str
    """RFC 3339, UTC."""
    software: str
    leader: Count
    """The run of the leader that ordered it; a restarted leader is another one."""
    number: Count
    """The burst's number in that run."""
    burst: BurstRecord
    cameras: tuple[CameraPlan, ...]
    pins: dict[str, str] = {}
    """By camera, the pin of the only machine that may deliver its part; empty on an open rig."""
    note: str = ""
    """What the manifest is to keep as a note."""
    spare: Count = 0
    """Number of extra instants, which replace incomplete ones."""
    chosen: tuple[Count, ...] | None = None
    """The instants that the session has; None while that is not settled, or where it has all."""
    streamed: InstantRange | None = None
    """The instants, where `burst` has none: frames are sent as they come."""
    schema_version: int = PLAN_VERSION

    @property
    def instants_ns(self) -> Sequence[int]:
        """The leader times of the instants that were ordered, in ns."""
        of = self.streamed
        if of is None:
            return self.burst.instants_ns
        return range(of.first_ns, of.first_ns + of.step_ns * of.count, of.step_ns)

    @property
    def key(self) -> tuple[int, int]:
        """What identifies the burst on nodes: the leader's run and the burst's number."""
        return self.leader, self.number


class _UncheckedPlan(BurstPlan, frozen=True, kw_only=True, forbid_unknown_fields=True):
    cameras: tuple[dict[str, Any], ...]  # type: ignore[assignment]


def read_plan(folder: Path) -> BurstPlan:
    """Read a session's plan, without the cameras whose part is not valid; its note names them.

    Raises BadInputError if there is no plan, or if no camera of it is valid.
    """
    unchecked = read_struct(folder / PLAN, _UncheckedPlan, PLAN_VERSION)
    check_name(unchecked.name, "session")
    cameras, notes = [], [unchecked.note] if unchecked.note else []
    for number, fields in enumerate(unchecked.cameras):
        try:
            part = convert(fields, CameraPlan)
            check_name(part.camera.name, "camera")
            check_written(part.camera)
            cameras.append(part)
        except (BadInputError, ValidationError) as error:
            camera = fields.get("camera")
            name = camera.get("name") if isinstance(camera, dict) else f"camera {number}"
            notes.append(f"{name} is left out: {error}")
    if not cameras:
        raise BadInputError(
            f"{folder / PLAN} has no valid camera: {'; '.join(notes)}",
            hint="the burst cannot be repaired; its images stay in the folder",
        )
    checked = {"cameras": tuple(cameras), "note": "; ".join(notes)}
    plan = BurstPlan(**structs.asdict(unchecked) | checked)
    if any(instant >= len(plan.instants_ns) for instant in plan.chosen or ()):
        raise BadInputError(
            f"{folder / PLAN} names a chosen instant that was not requested",
            hint="the burst cannot be repaired; its images stay in the folder",
        )
    return plan
