"""Messages of the transfer stream: images and reports from nodes, requests from operators."""

from typing import Annotated, Any, Self

from msgspec import Meta, field
from msgspec.structs import replace

from capture_app.common import errors
from capture_app.common.bounds import (
    Count,
    FilePath,
    Instance,
    Message,
    Number,
    Real,
    Sentence,
    Text,
    TimeNs,
)
from capture_app.common.errors import SimulshotError
from capture_app.common.names import Name
from capture_app.common.take_limits import meta
from capture_app.protocol.orders import FromOperator, FromViewfinder, ToOperator, ToViewfinder
from capture_app.protocol.pairing_messages import FromUnknown, Invite, Invited, SpeaksFor, ToUnknown
from capture_app.protocol.status import BurstStatus, RigStatus
from capture_app.session.format.burst_plan import CameraPlan
from capture_app.session.format.manifest import ImageRecord, Sha256
from capture_app.trust.datagram_keys import Grant
from capture_app.trust.identity import Proof
from capture_app.trust.known_machines import KnownMachine

"""Maximum duration of a recording, and of any wait."""
EventField = Annotated[str, Meta(max_length=40)]
EventValue = TimeNs | Real | Sentence | bool | None
MAX_BATCH_IMAGES = 256
MAX_EVENTS = 200
"""Maximum number of events in a report."""


class NodeStream(Message, frozen=True, kw_only=True, tag="node"):
    """First message of a node's stream; what follows belongs to the camera with which the node joined.

    The stream carries images or, with `shows`, previews and details on request.
    """

    camera: Name
    instance: Instance
    """Instance number of the node, from its hello; no other machine knows it."""
    shows: bool = False


class KeyRequest(Message, frozen=True, kw_only=True, tag="key-request"):
    """Request of a node for the key of its datagrams."""

    name: Name
    instance: Instance
    """Instance number of the node, which its hello will repeat."""
    is_relay: bool = False


class KeyAnswer(Message, frozen=True, kw_only=True, tag="key"):
    """Key for one instance of a node."""

    grant: Grant
    machines: tuple[KnownMachine, ...] = ()
    """Machines that the leader vouches for: the standbys; to a standby, all that it knows."""
    names: dict[Name, Text] = field(default_factory=dict)
    """For a standby: the pin of the machine that owns each camera name."""


class CameraReport(Message, frozen=True, kw_only=True, tag="camera-report"):
    """A node's part of a burst: its clock and phase, the frames to come, and the missing ones with reasons.

    `leader` is the leader's instance number: a burst of an earlier instance is a different burst.
    """

    leader: Number
    burst: Number
    plan: CameraPlan
    """Plan stored in the session; for frames sent as they arrive, `instants` lists the frames still to be
    sent.
    """
    events: Annotated[
        tuple[Annotated[dict[EventField, EventValue], Meta(max_length=16)], ...], Meta(max_length=MAX_EVENTS)
    ] = ()
    """Recent events of the node's engine; times in its own clock."""

    @property
    def camera(self) -> str:
        """Name of the camera."""
        return self.plan.camera.name

    def with_plan(self, **changes: Any) -> Self:
        """Return the report with these fields of its plan changed."""
        return replace(self, plan=replace(self.plan, **changes))


class ImageUpload(Message, frozen=True, kw_only=True):
    """Header of one image; its bytes are followed by `truth_bytes` of ground truth."""

    leader: Number
    burst: Number
    record: ImageRecord
    truth_bytes: Count = 0
    true_ns: TimeNs | None = None
    """True start of the first row's exposure, for a simulated frame."""
    truth_sha256: Sha256 | None = None

    @property
    def bytes(self) -> int:
        """Length with the ground truth."""
        return self.record.bytes + self.truth_bytes

    @property
    def sha256(self) -> str:
        """Checksum of the image."""
        return self.record.sha256


class ImageBatch(Message, frozen=True, kw_only=True, tag="images"):
    """Images of one camera's burst; the payload is their bytes, one after the other."""

    images: Annotated[tuple[ImageUpload, ...], Meta(min_length=1, max_length=MAX_BATCH_IMAGES)]

    @property
    def leader(self) -> int:
        """Id of the leader's run that ordered the burst."""
        return self.images[0].leader

    @property
    def burst(self) -> int:
        """Number of the burst in that run."""
        return self.images[0].burst

    @property
    def camera(self) -> str:
        """Name of the camera."""
        return self.images[0].record.camera

    @property
    def bytes(self) -> int:
        """Length of the payload."""
        return sum(image.bytes for image in self.images)

    @property
    def sha256(self) -> str:
        """Checksum by which it is acknowledged, its last image's."""
        return self.images[-1].sha256


class SpoolSpace(Message, frozen=True, kw_only=True, tag="spool-space"):
    """Free space of a node's spool, in bytes."""

    camera: Name
    free_bytes: Count
    spool: FilePath
    """Path of the spool on that node."""
    problem: Sentence = ""
    """Reason why it is currently unusable; images then stay in memory until the leader has them."""


class ImageAck(Message, frozen=True, kw_only=True, tag="image-ack"):
    """Acknowledgement that a batch of images is stored on the leader's disk."""

    sha256: str | None = None
    """None: the disk is slow to store the images received; the answer to each follows."""
    proof: Proof | None = None
    """Signature of the rig's leader, for a node below a relay."""


class ImageReceipt(Message, frozen=True, kw_only=True):
    """An image that the leader has stored on its disk."""

    instant: Count
    sha256: Sha256


class ReportAck(Message, frozen=True, kw_only=True, tag="report-ack"):
    """Acknowledgement of a node's report, with `receipts` for that camera's stored images."""

    receipts: tuple[ImageReceipt, ...] = ()
    requested: tuple[Count, ...] | None = None
    """Instants to send; None: all."""
    end: Count | None = None
    """Of a streamed burst, its number of instants: frames after its end are not needed."""
    undecided: bool = False
    """Whether `requested` still depends on reports of other cameras: ask again."""
    proof: Proof | None = None
    """Signature of the rig's leader, for a node below a relay."""


class Refusal(Message, frozen=True, kw_only=True, tag="refusal"):
    """Refusal by the leader: an error for the user, or a burst that is over."""

    what: str
    hint: str = ""
    error: str = "SimulshotError"
    """Class name of the leader's error, one of those in `errors`."""
    retry: bool = False
    """Whether to ask again: a disk is full, or a burst was closed and can be opened again."""
    forget: bool = False
    """Whether the burst was cancelled, so that its data may be deleted."""
    damaged: tuple[Count, ...] = ()
    """Instants of the damaged images of a batch; its other images are to be sent again."""
    proof: Proof | None = None
    """Signature of the rig's leader, for a node below a relay."""

    @classmethod
    def of_error(cls, error: SimulshotError) -> Self:
        """Make the refusal of an error of the leader, or of a relay that cannot connect to it."""
        return cls(
            what=error.what,
            hint=error.hint,
            error=type(error).__name__,
            retry=isinstance(error, errors.DiskError | errors.TryAgainError | errors.NetworkError),
            forget=isinstance(error, errors.UnwantedImageError),
            damaged=error.instants if isinstance(error, errors.DamagedImageError) else (),
        )

    def as_error(self) -> SimulshotError:
        """Return the leader's error, with its own class if this version has it."""
        kind = getattr(errors, self.error, SimulshotError)
        is_error = isinstance(kind, type) and issubclass(kind, SimulshotError)
        return (kind if is_error else SimulshotError)(self.what, hint=self.hint)


class StatusRequest(Message, frozen=True, kw_only=True, tag="status-request"):
    """Operator's request for the rig's status."""

    after: Text = ""
    """Name after which a page of a large rig's nodes begins."""


class StatusAnswer(Message, frozen=True, kw_only=True, tag="status"):
    """Current status of the rig."""

    rig: RigStatus


class BurstRequest(Message, frozen=True, kw_only=True, tag="burst-request"):
    """Operator's request for a burst once all nodes are ready, or after `wait_ready_s`."""

    frames: Annotated[int, meta("frames")] | None = None
    """None: as many as fit into `seconds`, or until the burst is ended."""
    spacing: Annotated[int, meta("spacing")] = 1
    interval_s: Annotated[float, meta("interval_s")] | None = None
    """Interval between frames in s; None: `spacing` applies."""
    seconds: Annotated[float, meta("seconds")] | None = None
    video: bool = False
    """Whether to take a recording, with a video per camera."""
    at_leader_ns: TimeNs | None = None
    wait_ready_s: Annotated[float, meta("wait_ready_s")] = 0.0
    nodes: Annotated[int, meta("nodes")] = 1
    """Minimum number of nodes that must be ready."""
    spare: Annotated[int, meta("spare")] | None = None
    """Number of further instants that replace those some camera misses; 0: instants must be consecutive,
    None: the leader chooses.
    """
    before: Annotated[int, meta("before")] = 0
    """Number of frames taken before the leader receives this request; 0 leaves nodes time to prepare."""
    name: Text = ""
    """Name of the take, with which its session's folder begins; a valid name, or empty for the default."""
    note: Annotated[str, Meta(max_length=10_000)] = ""
    """Note stored in the manifest."""


class BurstAnswer(Message, frozen=True, kw_only=True, tag="burst"):
    """Progress of a burst; the last one is `done` and names the session."""

    burst: BurstStatus


ToLeader = (
    NodeStream
    | CameraReport
    | ImageBatch
    | SpoolSpace
    | FromViewfinder
    | KeyRequest
    | StatusRequest
    | BurstRequest
    | FromOperator
    | FromUnknown
    | Invite
    | SpeaksFor
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
    | ToUnknown
    | Invited
)
