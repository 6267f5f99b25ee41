"""`burst.json`: the plan of a burst, on disk before its first image, to finish it by after a crash."""

from pathlib import Path

from msgspec import Struct

from capture_app.camera_facts import Count
from capture_app.clock import SimulatedClock
from capture_app.errors import BadInputError
from capture_app.names import Name, check_name
from capture_app.session.format.calibration import CameraCalibration
from capture_app.session.format.checks import read_struct
from capture_app.session.format.manifest import BurstRecord, CameraRecord, MissingImage

PLAN = "burst.json"
PLAN_VERSION = 1


class CameraPlan(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is known of one camera of a burst."""

    camera: CameraRecord
    """With the records of its clock and phase once it has reported."""
    reported: bool = False
    instants: tuple[Count, ...] = ()
    """The images that it has announced."""
    missing: tuple[MissingImage, ...] = ()
    """The images that it has reported missing."""
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
    note: str = ""
    """What the manifest is to keep as a note."""
    spare: Count = 0
    """So many of the instants only make up for those that not every camera has."""
    chosen: tuple[Count, ...] | None = None
    """The instants that the session has; None while that is not settled, or where it has all."""
    schema_version: int = PLAN_VERSION

    @property
    def key(self) -> tuple[int, int]:
        """What identifies the burst on nodes: the leader's run and the burst's number."""
        return self.leader, self.number


def read_plan(folder: Path) -> BurstPlan:
    """Read a session's plan. Raises BadInputError where it has none or it cannot be trusted."""
    plan = read_struct(folder / PLAN, BurstPlan, PLAN_VERSION)
    check_name(plan.name, "session")
    for share in plan.cameras:
        check_name(share.camera.name, "camera")
    if any(instant >= len(plan.burst.instants_ns) for instant in plan.chosen or ()):
        raise BadInputError(f"{folder / PLAN} has chosen an instant that was not ordered")
    return plan
