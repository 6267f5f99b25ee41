"""Messages of those who look at a rig and give it orders, and of nodes that show what they see."""

from typing import Annotated

from msgspec import Meta, field

from capture_app.common.camera_facts import CameraControls, Control, ControlValue, StampAccuracy
from capture_app.common.names import Name
from capture_app.protocol.message import Message
from capture_app.protocol.status import NewsLine, NodeDetail, Preview
from capture_app.sync.clock.clock_filter import KnownWay

MAX_PREVIEW_PX = 1920
MAX_NODES = 64
"""Most cameras that run on one machine as processes of its leader."""
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
    """An operator wants to be told on this stream what changes, until it closes it."""


class NewsAnswer(Message, frozen=True, kw_only=True, tag="news"):
    """What has happened since the last of these, or of late."""

    lines: tuple[NewsLine, ...]


class PreviewsWanted(Message, frozen=True, kw_only=True, tag="previews-wanted"):
    """Which previews an operator wants of a leader, or a leader of a node, from now on."""

    cameras: tuple[str, ...] | None = None
    """None: all."""
    width: Annotated[int, Meta(ge=16, le=MAX_PREVIEW_PX)]
    """In pixels, about."""
    fps: Annotated[float, Meta(ge=0, le=30)]
    """At most so many a second of each camera; 0: none."""


class PreviewSeen(Message, frozen=True, kw_only=True, tag="preview-seen"):
    """A preview has arrived: a slow link skips pictures rather than fill with them."""

    camera: str


class DetailRequest(Message, frozen=True, kw_only=True, tag="detail-request"):
    """An operator wants to know all that a node knows of itself."""

    camera: str


class ControlsRequest(Message, frozen=True, kw_only=True, tag="controls-request"):
    """An operator wants to know the controls of a camera, or sets some of them."""

    camera: Name
    wanted: dict[Control, ControlValue] = field(default_factory=dict)
    """Empty: none is set."""


class ControlsAnswer(Message, frozen=True, kw_only=True, tag="controls"):
    """The controls of a camera as they stand, and what of a request it could not do."""

    camera: Name
    state: CameraControls


class ExposeAppPhones(Message, frozen=True, kw_only=True, tag="expose-app-phones"):
    """Have phones with libsoftwaresync or RecSync expose so; they answer nothing."""

    exposure_ns: Annotated[int, Meta(gt=0, le=1_000_000_000)]
    iso: Annotated[int, Meta(gt=0, le=1_000_000)]


class Vitals(Message, frozen=True, kw_only=True, tag="vitals"):
    """How a node's camera runs at present."""

    fps: float | None = None
    exposure_ns: int | None = None
    gain: float | None = None


class AddCamera(Message, frozen=True, kw_only=True, tag="add-camera"):
    """Start a camera of the leader's machine; without a name it gets one."""

    spec: str
    name: str | None = None


class AddSimulated(Message, frozen=True, kw_only=True, tag="add-simulated"):
    """Start so many further simulated cameras on the leader's machine."""

    cameras: int
    scene: str = "studio"
    options: str = "drops=0"
    """Options of each camera's spec: without drops all pictures can be compared."""
    tolerance_us: int | None = None
    """Phase errors up to this are left alone; None: the default of the camera's kind."""


class RemoveCamera(Message, frozen=True, kw_only=True, tag="remove-camera"):
    """End a node that is a process of the leader's, or forget one that is lost; a phone's is told itself."""

    name: str


class KeepStamp(Message, frozen=True, kw_only=True, tag="keep-stamp"):
    """How late a camera's pictures are was measured: its node goes by that, and keeps it."""

    camera: Name
    stamp: StampAccuracy | None = None
    """How late its stamps are, kept for the device."""
    way: KnownWay | None = None
    """How much later than that, by the leader's clock as it is known now: kept for the link."""


class StampKept(Message, frozen=True, kw_only=True, tag="stamp-kept"):
    """A node goes by what it was told; whether it could keep it, too."""

    camera: Name
    kept: bool


class CancelBurst(Message, frozen=True, kw_only=True, tag="cancel-burst"):
    """Wait no longer for the images of a burst."""

    burst: int


class EndBurst(Message, frozen=True, kw_only=True, tag="end-burst"):
    """Let a recording, or a long burst, end now and save it; None: the newest one."""

    burst: int | None = None


class StopRig(Message, frozen=True, kw_only=True, tag="stop-rig"):
    """End the leader and the nodes that are its processes."""


class InvitePhone(Message, frozen=True, kw_only=True, tag="invite-phone"):
    """An operator wants the page by which the next phone becomes a camera; it is served from then on."""


class PhoneInvited(Message, frozen=True, kw_only=True, tag="phone-invited"):
    """The page of the next phone; another one when a phone has come by it, or its time is over."""

    url: str
    fingerprint: str
    """SHA-256 of its certificate, as browsers show it."""
    good_for_s: int


class Done(Message, frozen=True, kw_only=True, tag="done"):
    """What was asked for has been done."""

    names: tuple[str, ...] = ()
    """The cameras that were started."""


Order = (
    AddCamera | AddSimulated | RemoveCamera | InvitePhone | CancelBurst | EndBurst | StopRig | ExposeAppPhones
)
"""What an operator can ask a leader to do, beside a burst."""
FromOperator = (
    WatchRequest | PreviewsWanted | PreviewSeen | DetailRequest | ControlsRequest | KeepStamp | Order
)
FromViewfinder = Vitals | Preview | NodeDetail | ControlsAnswer | StampKept
ToOperator = NewsAnswer | Preview | NodeDetail | ControlsAnswer | StampKept | PhoneInvited | Done
ToViewfinder = PreviewsWanted | PreviewSeen | DetailRequest | ControlsRequest | KeepStamp | RemoveCamera
