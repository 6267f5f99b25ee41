"""`burst.json`: the plan of a burst, written before its first image, so that a burst survives a crash."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from msgspec import Struct, ValidationError, convert, structs

from capture_app.common.bounds import Count, Positive, Sentence, TimeNs
from capture_app.common.clock import SimulatedClock
from capture_app.common.errors import BadInputError
from capture_app.common.names import Name
from capture_app.session.files.untrusted_files import RESTORE, read_struct, rejecting
from capture_app.session.format.calibration import CameraCalibration
from capture_app.session.format.manifest import BurstRecord, CameraRecord, MissingImage

PLAN = "burst.json"
PLAN_VERSION = 2


class MissingRun(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Consecutive instants without a frame of a camera, all for one reason."""

    first: Count
    count: Count
    reason: Sentence
    dropped: bool = False
    """The camera dropped the frames."""


class InstantRange(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Evenly spaced instants of a streamed burst, which may have millions; times in ns."""

    first_ns: TimeNs
    step_ns: Positive
    count: Positive
    video: bool = False
    """Whether frames are stored in a video for each camera."""


class CameraPlan(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One camera's part of a burst: its record, its announced images, and its missing ones."""

    camera: CameraRecord
    """The camera's record; it has clock and phase once the camera has reported."""
    reported: bool = False
    instants: tuple[Count, ...] = ()
    """Instants of the images that the camera has announced."""
    missing: tuple[MissingImage, ...] = ()
    """Images that the camera has reported missing."""
    picking: bool = False
    """Whether the node will select and announce further frames."""
    picked: Count | None = None
    """Of a streamed burst: all instants below this number are announced or missing."""
    missing_runs: tuple[MissingRun, ...] = ()
    calibration: CameraCalibration | None = None
    true_clock: SimulatedClock | None = None
    """True parameters of a simulated camera's clock."""


class BurstPlan(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Plan of a burst in progress: its instants, its cameras, and the reports of these cameras."""

    name: Name
    created: str
    """RFC 3339, UTC."""
    software: str
    leader: Count
    """Id of the leader's run that ordered the burst; a restarted leader has a new one."""
    number: Count
    """The burst's number in that run."""
    burst: BurstRecord
    cameras: tuple[CameraPlan, ...]
    pins: dict[str, str] = {}
    """Pin of the only machine that may deliver each camera's images, by camera; empty on an open rig."""
    note: str = ""
    """Note for the manifest."""
    spare: Count = 0
    """Number of extra instants, which replace incomplete ones."""
    chosen: tuple[Count, ...] | None = None
    """Numbers of the ordered instants that the session has; None while undecided, or for all of them."""
    streamed: InstantRange | None = None
    """Instants of a streamed burst, whose frames are sent as they are captured; `burst` then has none."""
    unix_minus_leader_ns: int | None = None
    """Wall clock minus leader time at the order, ns: another difference means another clock."""
    schema_version: int = PLAN_VERSION

    @property
    def instants_ns(self) -> Sequence[int]:
        """Leader times of the ordered instants, ns."""
        if (streamed := self.streamed) is None:
            return self.burst.instants_ns
        return range(
            streamed.first_ns, streamed.first_ns + streamed.step_ns * streamed.count, streamed.step_ns
        )

    @property
    def key(self) -> tuple[int, int]:
        """Key that identifies the burst on nodes: the leader's run and the burst's number."""
        return self.leader, self.number


def read_plan(folder: Path) -> BurstPlan:
    """Read a session's plan; cameras with an invalid part are left out and named in its note.

    Raises BadInputError if there is no plan, or if none of its cameras is valid.
    """
    fields = read_struct(folder / PLAN, dict[str, Any], PLAN_VERSION)
    parts = fields.get("cameras")
    valid, notes = [], []
    for number, part in enumerate(parts if isinstance(parts, list) else ()):
        try:
            convert(part, CameraPlan)
            valid.append(part)
        except ValidationError as error:
            record = part.get("camera") if isinstance(part, dict) else None
            name = record.get("name") if isinstance(record, dict) else f"camera {number}"
            notes.append(f"{name} is left out: {error}")
    with rejecting(f"{folder / PLAN} does not fit its schema", ValidationError, hint=RESTORE):
        plan = convert(fields | {"cameras": valid}, BurstPlan)
    unused = "the burst cannot be repaired; its images stay in the folder"
    if not valid:
        raise BadInputError(f"{folder / PLAN} has no valid camera: {'; '.join(notes)}", hint=unused)
    if any(instant >= len(plan.instants_ns) for instant in plan.chosen or ()):
        raise BadInputError(f"{folder / PLAN} names a chosen instant that was not requested", hint=unused)
    return structs.replace(plan, note="; ".join(filter(None, (plan.note, *notes))))
