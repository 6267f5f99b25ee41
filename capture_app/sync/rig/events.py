"""Events: what the engine tells the node around it, each a fact that has happened.

Unlike messages they never leave the process, so they carry time maps, estimates and frames.
"""

from dataclasses import dataclass
from typing import Literal, TypeVar

from capture_app.sync.phase.estimator import PhaseEstimate
from capture_app.sync.rig.frame_selection import FramesSelected
from capture_app.sync.timekeeping.clock_events import ClockEvent
from capture_app.sync.wire.camera_commands import CameraCommand

F = TypeVar("F")


@dataclass(frozen=True, slots=True)
class Joined:
    """The leader took this client in."""

    transfer_port: int
    """TCP port of the leader that images go to."""
    leader: int
    """The leader's run, a random number."""


@dataclass(frozen=True, slots=True)
class LeaderNews:
    """The leader did not take this client in, has something to say to whoever looks after it, or is lost.

    One that is lost fell silent, forgot this client or is followed no more. The client keeps asking to join.
    """

    what: Literal["refused", "said", "lost"]
    text: str
    """As the leader said it; of one that is lost why, in a few words."""


@dataclass(frozen=True, slots=True)
class FramesDropped:
    """The camera lost frames."""

    count: int
    """How many in a row."""
    sequence: int
    """The sequence number of the frame after them."""


@dataclass(frozen=True, slots=True)
class PhaseCorrected:
    """A command to move the phase went out."""

    command: CameraCommand
    """What the camera is to do."""
    before: PhaseEstimate | None
    """The phase that is to be corrected; None where it was not known."""


@dataclass(frozen=True, slots=True)
class AlignmentFailed:
    """The stream cannot be held on the rig's grid."""

    reason: str
    """Why, in a sentence for the user."""


@dataclass(frozen=True, slots=True)
class BurstCancelled:
    """A burst was taken back: nothing of it is to be saved or sent."""

    leader: int
    """The run of the leader that had ordered it."""
    burst: int
    """Its number within that run."""


@dataclass(frozen=True, slots=True)
class StrangeTrigger:
    """A trigger was refused: the leader that is to have ordered it is not the one that is followed."""

    leader: int
    """That leader's run, as the trigger says."""
    burst: int


ClientEvent = (
    Joined
    | LeaderNews
    | ClockEvent
    | FramesDropped
    | PhaseCorrected
    | AlignmentFailed
    | FramesSelected[F]
    | BurstCancelled
    | StrangeTrigger
)


@dataclass(frozen=True, slots=True)
class NodeChanged:
    """Something has become of a client's membership."""

    name: str
    """The client's."""
    change: Literal["joined", "returned", "moved", "lost", "forgotten", "refused"]
    """One that returned was lost or restarted, one that moved is here and joined another relay or the leader
    itself; one forgotten was lost for long, or put away by a person; one that is refused keeps asking."""
    reason: str = ""
    """Why it is lost, in a few words; why it is refused, as it is told, with what to do."""
    where: str = ""
    """Its new relay, empty for this leader; of one that is refused at which host, or below which relay."""


@dataclass(frozen=True, slots=True)
class BurstAnswered:
    """A client will save a burst, or will not."""

    name: str
    """The client's."""
    burst: int
    """Its number."""
    refusal: str = ""
    """Why not, as the client said it, or that it was lost or silent; empty where it will."""


LeaderEvent = NodeChanged | BurstAnswered
