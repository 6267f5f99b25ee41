"""Messages of the transfer stream: images and reports from nodes, requests from the command line."""

from typing import Annotated, Any, Self

from msgspec import Meta, field
from msgspec.structs import replace

from capture_app.common import errors
from capture_app.common.camera_facts import Count
from capture_app.common.errors import SimulshotError
from capture_app.common.names import Name
from capture_app.protocol.message import Message
from capture_app.protocol.orders import FromOperator, FromViewfinder, ToOperator, ToViewfinder
from capture_app.protocol.pairing import FromStranger, Invite, Invited, SpeaksFor, ToStranger
from capture_app.protocol.status import BurstStatus, RigStatus
from capture_app.session.format.burst_plan import CameraPlan
from capture_app.session.format.manifest import ImageRecord, Sha256
from capture_app.trust.keys import Grant
from capture_app.trust.known_machines import KnownMachine

LONGEST_S = 31 * 86_400.0
"""The longest recording, and the longest time that is waited for anything."""
JsonValue = int | float | str | bool | None


class NodeStream(Message, frozen=True, kw_only=True, tag="node"):
    """A node opens a stream; what follows on it is of that camera, which it joined with.

    It brings images, or shows on it what the camera sees, and details, when it is asked.
    """

    camera: Name
    instance: int
    """The node's run, as its hello told it: nobody else knows it."""
    shows: bool = False


class KeyRequest(Message, frozen=True, kw_only=True, tag="key-request"):
    """A node wants the key for its datagrams."""

    name: Name
    instance: int
    """The node's run, as its hello will tell it."""
    is_relay: bool = False


class KeyAnswer(Message, frozen=True, kw_only=True, tag="key"):
    """The key of one run of a node."""

    grant: Grant
    machines: tuple[KnownMachine, ...] = ()
    """Whom the leader vouches for: the standbys; to one of these, everybody that it knows."""
    names: dict[str, str] = field(default_factory=dict)
    """To a standby: whose camera each name is, by its machine's pin."""


class CameraReport(Message, frozen=True, kw_only=True, tag="camera-report"):
    """A node's part of a burst: its clock and phase, what will come, what will not, and why.

    `leader` is the leader's instance: a burst of an earlier run of it is not this run's.
    """

    leader: int
    burst: int
    plan: CameraPlan
    """What the session keeps of it; of frames that are sent as they come, `instants` are those that wait."""
    events: tuple[dict[str, JsonValue], ...] = ()
    """What the node's engine saw and did lately, times in its own clock."""

    @property
    def camera(self) -> str:
        """Whose part it is."""
        return self.plan.camera.name

    def with_plan(self, **changes: Any) -> Self:
        """The report with another plan in these fields."""
        return replace(self, plan=replace(self.plan, **changes))


class ImageUpload(Message, frozen=True, kw_only=True, tag="image"):
    """One image; the payload is its bytes and then `truth_bytes` of ground truth, from `offset` on."""

    leader: int
    burst: int
    record: ImageRecord
    truth_bytes: Count = 0
    true_ns: int | None = None
    """True start of the first row's exposure, of a simulated frame."""
    truth_sha256: Sha256 | None = None
    offset: Count = 0
    """How many bytes the leader has already, from a stream that broke off."""

    @property
    def camera(self) -> str:
        """Whose image it is."""
        return self.record.camera


class SpoolSpace(Message, frozen=True, kw_only=True, tag="spool-space"):
    """How much room a node's spool has, in bytes."""

    camera: str
    free_bytes: Count
    spool: str
    """Where it is, on that node."""
    problem: str = ""
    """Why it cannot be used at present: pictures are kept in memory until the leader has them."""


class ImageAck(Message, frozen=True, kw_only=True, tag="image-ack"):
    """An image is safely on the leader's disk."""

    sha256: str | None = None
    """None: the disk takes its time with the images that have come; the answer to each follows."""


class ImageReceipt(Message, frozen=True, kw_only=True):
    """What the leader has of an image: all of it, safely on its disk, or the first bytes."""

    instant: Count
    sha256: Sha256
    """The checksum of the whole image."""
    bytes: Count
    """How many there are of the image and its ground truth."""
    stored: bool


class ReportAck(Message, frozen=True, kw_only=True, tag="report-ack"):
    """The leader has a node's report, and of that camera's images what `receipts` say."""

    receipts: tuple[ImageReceipt, ...] = ()
    wanted: tuple[Count, ...] | None = None
    """Which instants are to be sent, where that is not all."""
    undecided: bool = False
    """That depends on cameras that have not told yet: ask again."""


class Refusal(Message, frozen=True, kw_only=True, tag="refusal"):
    """The leader will not do that: an error for the user, or a burst that is over."""

    what: str
    hint: str = ""
    error: str = "SimulshotError"
    """The class of the leader's error, one of those in `errors`."""
    retry: bool = False
    """It may be asked for again: a disk is full, or a burst was closed and can be opened again."""
    forget: bool = False
    """The burst was cancelled: what there is of it may be deleted."""

    @classmethod
    def of_error(cls, error: SimulshotError) -> Self:
        """Tell an error of the leader's, or of a relay that does not reach it."""
        retry = isinstance(error, errors.DiskError | errors.TryAgainError | errors.NetworkError)
        forget = isinstance(error, errors.CancelledBurstError)
        return cls(what=error.what, hint=error.hint, error=type(error).__name__, retry=retry, forget=forget)

    def as_error(self) -> SimulshotError:
        """The leader's error, of its own class where this version knows it."""
        kind = getattr(errors, self.error, SimulshotError)
        if not (isinstance(kind, type) and issubclass(kind, SimulshotError)):
            kind = SimulshotError
        return kind(self.what, hint=self.hint)


class StatusRequest(Message, frozen=True, kw_only=True, tag="status-request"):
    """The command line wants to see the rig."""

    after: str = ""
    """Its nodes by name from there on, in the pages of a large one."""


class StatusAnswer(Message, frozen=True, kw_only=True, tag="status"):
    """The rig at this moment."""

    rig: RigStatus


class BurstRequest(Message, frozen=True, kw_only=True, tag="burst-request"):
    """The command line wants a burst, as soon as all nodes are ready or `wait_ready_s` have passed."""

    frames: Annotated[int, Meta(gt=0)] | None = None
    """None: as many as `seconds` hold, or until it is ended."""
    spacing: Annotated[int, Meta(gt=0)] = 1
    interval_s: Annotated[float, Meta(gt=0, le=LONGEST_S)] | None = None
    """From one frame to the next; None: `spacing` tells."""
    seconds: Annotated[float, Meta(gt=0, le=LONGEST_S)] | None = None
    video: bool = False
    """Take a recording, with a video for each camera."""
    at_leader_ns: int | None = None
    wait_ready_s: Annotated[float, Meta(ge=0, le=LONGEST_S)] = 0.0
    nodes: Annotated[int, Meta(gt=0)] = 1
    """The fewest nodes that must be ready."""
    spare: Count | None = None
    """Further instants, to make up for those that not every camera has; 0: instants must be consecutive,
    None: the leader's choice."""
    before: Count = 0
    """How many of the frames are taken before the leader hears of this; 0 leaves nodes time to prepare."""
    name: str = ""
    """The name of the take: its session's folder begins with it. A valid name, or empty for the usual one."""
    note: str = ""
    """Kept in the manifest."""


class BurstAnswer(Message, frozen=True, kw_only=True, tag="burst"):
    """How far a burst is; the last one is done and names the session."""

    burst: BurstStatus


FromCamera = NodeStream | CameraReport | ImageUpload | SpoolSpace | FromViewfinder
ToLeader = (
    FromCamera | KeyRequest | StatusRequest | BurstRequest | FromOperator | FromStranger | Invite | SpeaksFor
)
FromLeader = (
    ImageAck
    | ReportAck
    | Refusal
    | KeyAnswer
    | StatusAnswer
    | BurstAnswer
    | ToOperator
    | ToViewfinder
    | ToStranger
    | Invited
)
