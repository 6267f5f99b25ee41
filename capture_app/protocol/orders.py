"""Messages of operators who watch and control a rig, and of nodes that send previews and details."""

from typing import Annotated

from msgspec import Meta, field

from capture_app.common.bounds import Count, Message, Number, Real, Sentence, Text, TimeNs
from capture_app.common.camera_facts import CameraControls, Control, ControlValue, StampAccuracy
from capture_app.common.names import Name
from capture_app.protocol.status import LogLine, NodeDetail, Preview
from capture_app.session.format.marks import Mark
from capture_app.sync.clock.clock_filter import PathAsymmetry

MAX_PREVIEW_PX = 1920
MAX_NODES = 64
"""Maximum number of cameras that run on one machine as processes of its leader."""
_CAM = tuple(f"cam{number:02d}" for number in range(MAX_NODES))
VIEWS = {
    "studio": _CAM[:7],
    "pinwheel": _CAM[:5],
    "crossing": _CAM[:3],
    "board": _CAM[:7],
    "bars": _CAM,
    "led-panel": _CAM,
}
"""Camera names of each simulated scene that `AddSimulated` accepts; the scene has a view for each name."""
FLAT_SCENES = ("bars", "led-panel")
"""Scenes without views: every camera sees the same."""


class WatchRequest(Message, frozen=True, kw_only=True, tag="watch"):
    """Operator's request to receive changes on this stream until it is closed."""


class LogAnswer(Message, frozen=True, kw_only=True, tag="log"):
    """Log lines since the previous one of these messages; the first has recent lines."""

    lines: tuple[LogLine, ...]


class PreviewRequest(Message, frozen=True, kw_only=True, tag="preview-request"):
    """Previews requested from now on, by an operator of a leader or by a leader of a node."""

    cameras: Annotated[tuple[Text, ...], Meta(max_length=2000)] | None = None
    """Names of cameras; None: all."""
    width: Annotated[int, Meta(ge=16, le=MAX_PREVIEW_PX)]
    """Approximate width in pixels."""
    fps: Annotated[float, Meta(ge=0, le=30)]
    """Maximum rate per camera; 0: no previews."""


NO_PREVIEWS = PreviewRequest(width=16, fps=0)


class PreviewSeen(Message, frozen=True, kw_only=True, tag="preview-seen"):
    """Acknowledgement of a preview: a slow link skips previews instead of queueing them."""

    camera: Text


class DetailRequest(Message, frozen=True, kw_only=True, tag="detail-request"):
    """Operator's request for a node's details."""

    camera: Text


class ControlsRequest(Message, frozen=True, kw_only=True, tag="controls-request"):
    """Operator's request to read a camera's controls, or to set some of them."""

    camera: Name
    values: dict[Control, ControlValue] = field(default_factory=dict)
    """Values to set; empty: none."""


class ControlsAnswer(Message, frozen=True, kw_only=True, tag="controls"):
    """Current controls of a camera, and the parts of a request that failed."""

    camera: Name
    state: CameraControls


class CameraHealth(Message, frozen=True, kw_only=True, tag="camera-health"):
    """Current frame rate, exposure and gain of a node's camera."""

    fps: Real | None = None
    exposure_ns: Count | None = None
    gain: Real | None = None


class AddCamera(Message, frozen=True, kw_only=True, tag="add-camera"):
    """Start a camera of the leader's machine; without a name it is assigned one."""

    spec: Sentence
    name: Text | None = None


class AddSimulated(Message, frozen=True, kw_only=True, tag="add-simulated"):
    """Start further simulated cameras on the leader's machine."""

    cameras: Number
    scene: Text = "studio"
    options: Sentence = "drops=0"
    """Options of each camera's spec; without drops all images can be compared."""
    tolerance_us: Count | None = None
    """Phase errors up to this are left alone; None: the default of the camera's kind."""


class RemoveCamera(Message, frozen=True, kw_only=True, tag="remove-camera"):
    """Stop a node that is a process of the leader, or forget a lost one; a phone's node is notified."""

    name: Text


class SaveStamp(Message, frozen=True, kw_only=True, tag="save-stamp"):
    """Measured timestamp delay of a camera, which its node uses and stores."""

    camera: Name
    stamp: StampAccuracy | None = None
    """Delay of its timestamps, stored for the device."""
    asymmetry: PathAsymmetry | None = None
    """Path asymmetry found beyond that, by the current estimate of the leader's clock; stored for the
    link. Its uncertainty is the measurement's alone."""


class StampSaved(Message, frozen=True, kw_only=True, tag="stamp-saved"):
    """Answer of a node that it uses a measured delay, and whether it could store it."""

    camera: Name
    is_stored: bool
    asymmetry_uncertainty_ns: Real | None = None
    """95 % uncertainty of the path asymmetry, including the node's own clock's."""


class CancelBurst(Message, frozen=True, kw_only=True, tag="cancel-burst"):
    """Stop waiting for the images of a burst."""

    burst: Number


class EndBurst(Message, frozen=True, kw_only=True, tag="end-burst"):
    """End a recording or a long burst now and save it; None: the newest one."""

    burst: Number | None = None


class StaggerCameras(Message, frozen=True, kw_only=True, tag="stagger"):
    """Take the cameras' frames one after the other from now on, or all at one instant again."""

    order: Sentence = ""
    """As the option --stagger; empty: all at one instant."""


class StopRig(Message, frozen=True, kw_only=True, tag="stop-rig"):
    """Stop the leader and the nodes that are its processes."""


class InvitePhone(Message, frozen=True, kw_only=True, tag="invite-phone"):
    """Operator's request for the page that makes the next phone a camera; it is served from then on."""


class PhoneInvited(Message, frozen=True, kw_only=True, tag="phone-invited"):
    """Page for the next phone; it changes when a phone has used it, or its time is over."""

    url: str
    fingerprint: str
    """SHA-256 of the page's certificate, as browsers display it."""
    good_for_s: int


class AskTime(Message, frozen=True, kw_only=True, tag="ask-time"):
    """Operator's request for the leader's time."""


class TimeAnswer(Message, frozen=True, kw_only=True, tag="time"):
    """Time of the leader when it answered, by its own clock and as Unix time."""

    leader_ns: TimeNs
    unix_ns: TimeNs


class PlaceMark(Message, frozen=True, kw_only=True, tag="place-mark"):
    """Operator's mark for the takes that it falls into."""

    mark: Mark


class MarkPlaced(Message, frozen=True, kw_only=True, tag="mark-placed"):
    """Names of the sessions that a mark was stored in; if there are none, the file that has it instead."""

    sessions: tuple[str, ...]
    file: str = ""


class Done(Message, frozen=True, kw_only=True, tag="done"):
    """Confirmation that a request was carried out."""

    names: tuple[str, ...] = ()
    """Names of the cameras started."""


Order = (
    AddCamera | AddSimulated | RemoveCamera | InvitePhone | CancelBurst | EndBurst | StaggerCameras | StopRig
)
"""Orders of an operator to a leader, besides a burst."""
FromOperator = (
    WatchRequest
    | PreviewRequest
    | PreviewSeen
    | DetailRequest
    | ControlsRequest
    | SaveStamp
    | AskTime
    | PlaceMark
    | Order
)
FromViewfinder = CameraHealth | Preview | NodeDetail | ControlsAnswer | StampSaved
ToOperator = (
    LogAnswer
    | Preview
    | NodeDetail
    | ControlsAnswer
    | StampSaved
    | PhoneInvited
    | TimeAnswer
    | MarkPlaced
    | Done
)
ToViewfinder = PreviewRequest | PreviewSeen | DetailRequest | ControlsRequest | SaveStamp | RemoveCamera
