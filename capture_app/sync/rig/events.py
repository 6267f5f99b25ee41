"""What the engine tells the node around it; each a fact that has happened."""

from dataclasses import dataclass
from typing import Generic, TypeVar

from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.phase.estimator import PhaseEstimate
from capture_app.sync.rig.frame_picks import Gap, Pick
from capture_app.sync.wire.beacon import Group
from capture_app.sync.wire.camera_commands import CameraCommand

F = TypeVar("F")


@dataclass(frozen=True, slots=True)
class Joined:
    """The leader of that instance took this client in; images go to that TCP port of it.

    `beacons` is where its beacons can be heard, None where it sends none.
    """

    transfer_port: int
    leader: int
    beacons: Group | None = None


@dataclass(frozen=True, slots=True)
class JoinRefused:
    """The leader did not take this client in; it keeps asking."""

    reason: str


@dataclass(frozen=True, slots=True)
class LeaderLost:
    """The leader fell silent or forgot this client; it keeps asking to join."""

    reason: str


@dataclass(frozen=True, slots=True)
class ClockSynced:
    """Enough samples for a first estimate of the leader's clock."""

    time_map: TimeMap


@dataclass(frozen=True, slots=True)
class ClockStepped:
    """One of the clocks jumped; the estimate starts anew."""


@dataclass(frozen=True, slots=True)
class ReferenceCorrectionStarted:
    """The clock is being moved to where all agree that hear the same beacons; 95 % error between them."""

    relative_uncertainty_ns: int


@dataclass(frozen=True, slots=True)
class ReferenceCorrectionEnded:
    """Nothing was agreed for long: the clock is again what the leader's answers alone tell."""


@dataclass(frozen=True, slots=True)
class FramesDropped:
    """The camera lost frames just before this sequence number."""

    count: int
    sequence: int


@dataclass(frozen=True, slots=True)
class PhaseCorrected:
    """A command to move the phase went out; `before` is the estimate it answers."""

    command: CameraCommand
    before: PhaseEstimate | None


@dataclass(frozen=True, slots=True)
class AlignmentFailed:
    """The stream cannot be held on the rig's grid."""

    reason: str


@dataclass(frozen=True, slots=True)
class BurstPicked(Generic[F]):
    """The frames of a burst are picked: save and send them; `leader` is the run that ordered it."""

    leader: int
    burst: int
    picks: tuple[Pick[F], ...]
    gaps: tuple[Gap, ...]
    time_map: TimeMap
    phase: PhaseEstimate | None


ClientEvent = (
    Joined
    | JoinRefused
    | LeaderLost
    | ClockSynced
    | ClockStepped
    | ReferenceCorrectionStarted
    | ReferenceCorrectionEnded
    | FramesDropped
    | PhaseCorrected
    | AlignmentFailed
    | BurstPicked[F]
)


@dataclass(frozen=True, slots=True)
class NodeJoined:
    """A client joined."""

    name: str


@dataclass(frozen=True, slots=True)
class NodeReturned:
    """A client that was lost or restarted joined again."""

    name: str


@dataclass(frozen=True, slots=True)
class NodeMoved:
    """A client that is here joined another relay; None where it left its relay for this leader."""

    name: str
    relay: str | None


@dataclass(frozen=True, slots=True)
class NodeLost:
    """A client fell silent, or left of its own will."""

    name: str
    reason: str


@dataclass(frozen=True, slots=True)
class BurstAccepted:
    """A client will save the burst."""

    name: str
    burst: int


@dataclass(frozen=True, slots=True)
class BurstRefused:
    """A client will not save the burst, or never answered."""

    name: str
    burst: int
    reason: str


LeaderEvent = NodeJoined | NodeReturned | NodeMoved | NodeLost | BurstAccepted | BurstRefused
