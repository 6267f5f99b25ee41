"""One status, many faces: frozen snapshots that the terminal UI, --json and the logs all show."""

from msgspec import Struct

from capture_app.camera_facts import CameraFacts
from capture_app.sync.wire.messages import NodeState


class NodeStatus(Struct, frozen=True, kw_only=True):
    """One camera node as the leader sees it; times in ns, None where not known yet."""

    name: str
    address: str
    state: NodeState
    camera: CameraFacts
    offset_ns: int | None = None
    hard_bound_ns: int | None = None
    uncertainty_ns: int | None = None
    round_trip_ns: int | None = None
    skew_ppm: float | None = None
    samples: int = 0
    phase_error_ns: int | None = None
    period_ns: int | None = None
    drift_ppm: float | None = None
    corrections: int = 0
    frames: int = 0
    drops: int = 0
    parent: str | None = None
    """The relay that it joined; None where that is the leader itself."""
    depth: int = 1
    """How many clocks its time has come through: 1 below the leader, 2 below a relay of it."""
    reference_correction_ns: int | None = None
    """By how much agreement with other nodes that hear the same packets has moved its clock."""
    relative_uncertainty_ns: int | None = None
    """95 % error of its clock against theirs."""
    last_seen_ns: int = 0
    """Age of the last message, in ns."""
    message: str = ""
    """Why it is in this state, where that is not plain."""


class BurstStatus(Struct, frozen=True, kw_only=True):
    """A burst under way or just saved."""

    burst: int
    name: str
    cameras: int
    instants: int
    received: int
    expected: int
    done: bool = False
    session: str | None = None
    message: str = ""


class RigStatus(Struct, frozen=True, kw_only=True):
    """The whole rig at one moment."""

    leader: str
    """host:port that nodes join."""
    relay: str | None = None
    """Name of the relay that tells this because it has no leader at present; None from a leader."""
    message: str = ""
    """What a user should know of the rig as a whole."""
    now_ns: int
    period_ns: int | None
    nodes: tuple[NodeStatus, ...] = ()
    burst: BurstStatus | None = None
    sessions: tuple[str, ...] = ()
    """Paths of the sessions saved by this leader, newest last."""
