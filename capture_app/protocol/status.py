"""Snapshots of a rig for operators: status, log lines, previews, and one node in detail."""

from collections.abc import Iterator
from typing import Literal

from msgspec import Struct

from capture_app.common.camera_facts import CameraFacts, ControlState, Count
from capture_app.common.names import Name
from capture_app.common.node_state import WITHOUT_CAMERA
from capture_app.protocol.message import Message
from capture_app.session.format.manifest import SkippedInstant
from capture_app.sync.wire.messages import Report

LOST_IS_NEWS_NS = 60_000_000_000
"""That a camera is lost is said of the whole rig so long after its last message; its own line goes on to."""


class NodeStatus(Report, frozen=True, kw_only=True, array_like=False):
    """A node's own report, with what the leader knows of it; times in ns, None where not known yet."""

    name: str
    address: str
    camera: CameraFacts
    parent: str | None = None
    """The relay that it joined; None where that is the leader itself."""
    depth: int = 1
    """How many clocks its time has come through: 1 below the leader, 2 below a relay of it."""
    last_seen_ns: int = 0
    """Age of the last message, in ns."""
    fps: float | None = None
    """Frames a second that have really come lately, drops not counted."""
    exposure_ns: int | None = None
    """The newest frame's, as the gain; a camera with automatic exposure changes both."""
    gain: float | None = None
    disk_free_bytes: int | None = None
    """Room in the node's spool."""
    on_leader: bool = False
    """It is a process of the leader's, which an operator can remove."""

    @property
    def time_error_ns(self) -> int | None:
        """95 % error of its frames' times: its clock's, and that of its stamps; None where not known."""
        clock_ns = self.uncertainty_ns if self.uncertainty_ns is not None else self.hard_bound_ns
        if clock_ns is None or self.camera.kind in WITHOUT_CAMERA:
            return clock_ns
        return clock_ns + self.camera.stamp_accuracy.uncertainty_ns


def in_tree_order(nodes: tuple[NodeStatus, ...]) -> Iterator[NodeStatus]:
    """Yield nodes in the order of a tree: each relay, then what is below it; every node once."""
    names = {node.name for node in nodes}
    below: dict[str | None, list[NodeStatus]] = {}
    for node in nodes:
        # Cameras may be left of a relay that is not known any more.
        below.setdefault(node.parent if node.parent in names else None, []).append(node)
    shown: set[str] = set()
    stack = below.get(None, [])[::-1]
    while stack:
        node = stack.pop()
        shown.add(node.name)
        yield node
        stack += [child for child in below.get(node.name, [])[::-1] if child.name not in shown]
    yield from (node for node in nodes if node.name not in shown)


class CameraTransfer(Struct, frozen=True, kw_only=True):
    """How much of a burst one camera has brought, in images; `problem` says why no more will come."""

    camera: str
    received: int
    expected: int
    problem: str = ""


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
    recording: bool = False
    """It is a recording: `expected` are the frames until now."""
    transfer: tuple[CameraTransfer, ...] = ()
    """How much has come of each camera, by name."""
    skipped: tuple[SkippedInstant, ...] = ()
    """Moments that were left out, as not every camera had its frame; later ones took their place."""


class FollowerStatus(Struct, frozen=True, kw_only=True):
    """A device that another program makes follow the rig; times in ns, None where not known yet."""

    name: str
    address: str
    state: str
    """synchronizing, synced or lost."""
    uncertainty_ns: int | None = None
    """95 % of the error of the time that it was given, at its worst before it gets the next."""
    hard_bound_ns: int | None = None
    skew_ppm: float | None = None
    round_trip_ns: int | None = None
    samples: int = 0
    last_seen_ns: int = 0


class BurstAhead(Struct, frozen=True, kw_only=True):
    """A burst that is ordered and begins later."""

    burst: int
    name: str
    first_leader_ns: int
    """Its first instant, in leader time."""
    instants: int


class RigStatus(Struct, frozen=True, kw_only=True):
    """The whole rig at one moment."""

    leader: str
    """host:port that nodes join."""
    is_open: bool = False
    """Whether it asks no machine who it is."""
    relay: str | None = None
    """Name of the relay that tells this because it has no leader at present; None from a leader."""
    message: str = ""
    """What a user should know of the rig as a whole."""
    advice: str = ""
    """One sentence: why the rig is not ready and what to do, or how accurate it is."""
    now_ns: int
    period_ns: int | None
    nodes: tuple[NodeStatus, ...] = ()
    further: int = 0
    """How many nodes follow those in this page, by name; `message` sums them up."""
    app_phones: tuple[FollowerStatus, ...] = ()
    """Phones with libsoftwaresync or RecSync; their pictures stay on them."""
    burst: BurstStatus | None = None
    ahead: tuple[BurstAhead, ...] = ()
    """Bursts that begin much later; they can be cancelled."""
    sessions: tuple[str, ...] = ()
    """Paths of the newest sessions saved by this leader, newest last."""
    sessions_folder: str = ""
    """Where it saves them, on its machine."""
    disk_free_bytes: int | None = None
    """Room on that folder's disk."""


Level = Literal["info", "warning", "error"]


class NewsLine(Struct, frozen=True, kw_only=True):
    """Something that happened, as a person reads it."""

    unix_ns: int
    """When, by the teller's calendar clock; each line of one teller is later than the one before."""
    text: str
    camera: str | None = None
    """The node that it is about, where it is about one."""
    level: Level = "info"


class Preview(Message, frozen=True, kw_only=True, tag="preview", omit_defaults=True):
    """A small picture of what a camera sees; the next of this camera is sent after a `PreviewSeen`."""

    camera: Name
    leader_ns: int | None
    """Leader time of the frame; None while the node's clock is not known."""
    width: Count
    """In pixels, as the height."""
    height: Count
    jpeg: bytes = b""
    """The payload of the message, and no part of it."""


class NodeDetail(Message, frozen=True, kw_only=True, tag="detail"):
    """What a node knows of itself that is too much for a status; times in ns, newest last."""

    camera: str
    samples: tuple[tuple[int, int], ...] = ()
    """Offset (leader minus local time, as of the latest one) and round trip of exchanges with the leader."""
    phase_errors_ns: tuple[int, ...] = ()
    """Distance of the latest frames from the rig's grid."""
    log: tuple[NewsLine, ...] = ()
    fps: float | None = None
    exposure_ns: int | None = None
    gain: float | None = None
    white_balance: tuple[float, float] | None = None
    """Red and blue gains over green."""
    controls: tuple[ControlState, ...] = ()
    """As they were a few seconds ago at most."""
    spool: str = ""
    """Folder of that machine that keeps images until the leader has them; empty where memory does."""
    disk_free_bytes: int | None = None
