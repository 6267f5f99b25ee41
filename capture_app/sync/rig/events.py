"""Events that the engine reports to its node.

Unlike messages they never leave the process, so they carry time maps, estimates and frames.
"""

from dataclasses import dataclass
from typing import Literal

from capture_app.sync.phase.estimator import PhaseEstimate
from capture_app.sync.rig.frame_selection import F, FramesSelected
from capture_app.sync.timekeeping.clock_events import ClockEvent
from capture_app.sync.wire.camera_commands import CameraCommand


@dataclass(frozen=True, slots=True)
class Joined:
    """The leader admitted this client."""

    transfer_port: int
    """TCP port of the leader that receives images."""
    leader: int
    """Random instance number of the leader."""


@dataclass(frozen=True, slots=True)
class LeaderNotice:
    """The leader refused this client, sent a message to its operator, or was lost.

    A lost leader fell silent, forgot this client or is no longer followed. The client keeps asking to join.
    """

    what: Literal["refused", "said", "lost"]
    text: str
    """Text from the leader; for a lost leader the reason, in a few words."""


@dataclass(frozen=True, slots=True)
class FramesDropped:
    """The camera dropped frames."""

    count: int
    """Number of consecutive dropped frames."""
    sequence: int
    """Sequence number of the frame after them."""


@dataclass(frozen=True, slots=True)
class PhaseCorrected:
    """A command to move the phase was sent."""

    command: CameraCommand
    """Command for the camera."""
    before: PhaseEstimate | None
    """Phase before the correction; None if unknown."""


@dataclass(frozen=True, slots=True)
class PhaseMoved:
    """A stream was moved while frames of it were selected; times in ns of the local clock."""

    local_ns: int
    """Timestamp of the first frame after the move; one to three frames before it lasted longer."""
    shift_ns: int
    """Delay of all frames from then on."""


@dataclass(frozen=True, slots=True)
class AlignmentFailed:
    """The stream cannot be held on the rig's grid."""

    reason: str
    """Reason, in a sentence for the user."""


@dataclass(frozen=True, slots=True)
class TriggerCancelled:
    """A burst was cancelled: nothing of it is to be saved or sent."""

    leader: int
    """Instance number of the leader that had ordered it."""
    burst: int
    """Number of the burst within that instance."""


@dataclass(frozen=True, slots=True)
class ForeignTrigger:
    """A trigger was refused: it names a leader that is not followed."""

    leader: int
    """Instance number of that leader, from the trigger."""
    burst: int


ClientEvent = (
    Joined
    | LeaderNotice
    | ClockEvent
    | FramesDropped
    | PhaseCorrected
    | PhaseMoved
    | AlignmentFailed
    | FramesSelected[F]
    | TriggerCancelled
    | ForeignTrigger
)


@dataclass(frozen=True, slots=True)
class NodeChanged:
    """A client joined, returned, moved, was lost, forgotten or refused."""

    name: str
    """Name of the client."""
    change: Literal["joined", "returned", "moved", "lost", "forgotten", "refused"]
    """returned: was lost or restarted; moved: joined another relay, or the leader itself, while present;
    forgotten: was lost for long, or removed by an operator; refused: keeps asking."""
    reason: str = ""
    """Reason of a loss, in a few words; of a refusal as the client receives it, with the remedy."""
    where: str = ""
    """Its new relay, empty for this leader; for a refused client its host, or the relay above it."""


@dataclass(frozen=True, slots=True)
class TriggerAnswered:
    """A client accepted or refused a burst."""

    name: str
    """Name of the client."""
    burst: int
    """Number of the burst."""
    refusal: str = ""
    """Reason given by the client, or that it was lost or silent; empty if it accepted."""
    is_silent: bool = False
    """Whether it has not answered: it may have the burst all the same."""


LeaderEvent = NodeChanged | TriggerAnswered
