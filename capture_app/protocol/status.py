"""Snapshots of a rig for operators: status, log lines, previews, and details of one node."""

from typing import Annotated, Literal

from msgspec import Meta, Struct

from capture_app.common.bounds import Count, FilePath, Message, Pixels, Real, Sentence, Text, TimeNs
from capture_app.common.camera_facts import CameraFacts, ControlState
from capture_app.common.names import Name, titles_of
from capture_app.common.node_state import WITHOUT_CAMERA, NodeState
from capture_app.common.stagger import EVEN
from capture_app.session.format.manifest import SkippedInstant
from capture_app.sync.wire.datagrams import Report

MAX_DETAILS = 1000
"""Maximum length of each list of a node's details."""
REPORT_LOST_NS = 60_000_000_000
"""Time after a lost camera's last message during which the rig's summary mentions the loss; its own line
stays."""


class NodeStatus(Report, frozen=True, kw_only=True, array_like=False):
    """A node's own report, with the leader's data about it; times in ns, None while unknown."""

    name: str
    address: str
    camera: CameraFacts
    parent: str | None = None
    """Name of the relay that it joined; None for the leader itself."""
    depth: int = 1
    """Number of clocks between its time and the leader's: 1 below the leader, 2 below a relay of it."""
    last_seen_ns: int = 0
    """Age of the last message, in ns."""
    fps: float | None = None
    """Recent rate of delivered frames per second, without dropped ones."""
    exposure_ns: int | None = None
    """Exposure of the newest frame, as `gain`; a camera with automatic exposure changes both."""
    gain: float | None = None
    disk_free_bytes: int | None = None
    """Free space of the node's spool."""
    on_leader: bool = False
    """Whether it is a process of the leader, which an operator can remove."""
    spec: str = ""
    """Spec of such a camera, without its password, with which the next leader can start it again."""

    @property
    def time_error_ns(self) -> int | None:
        """95 % uncertainty of its frames' times, from clock and timestamps; None while unknown."""
        clock_ns = self.uncertainty_ns if self.uncertainty_ns is not None else self.hard_bound_ns
        if clock_ns is None or self.camera.kind in WITHOUT_CAMERA:
            return clock_ns
        return clock_ns + self.camera.stamp_accuracy.uncertainty_ns

    @property
    def is_settled(self) -> bool:
        """Whether the camera is synchronized; includes brief phase corrections."""
        close = abs(self.phase_error_ns or 0) <= 2 * self.tolerance_ns
        return close and self.state in (NodeState.READY, NodeState.ALIGNING)

    @property
    def is_settling(self) -> bool:
        """Whether a take should wait for the camera; not if it is lost or briefly corrects a drift."""
        corrects = self.is_settled and self.phase_error_ns is not None
        return not corrects and self.state not in (NodeState.READY, NodeState.LOST)


def in_tree_order(nodes: tuple[NodeStatus, ...]) -> list[NodeStatus]:
    """Return every node once, by name in tree order: each relay, then the nodes below it."""
    by_name = {node.name: node for node in nodes}

    def path(node: NodeStatus) -> list[str]:
        """Return the names from the root to a node; of relays said to be below each other, each once."""
        names: list[str] = []
        above: NodeStatus | None = node
        while above is not None and above.name not in names:
            names.insert(0, above.name)
            # The relay of a node may already be forgotten.
            above = by_name.get(above.parent or "")
        return names

    return sorted(nodes, key=path)


class CameraTransfer(Struct, frozen=True, kw_only=True):
    """Progress of one camera's part of a burst, in images; `problem` says why no more will arrive."""

    camera: str
    received: int
    expected: int
    problem: str = ""
    label: str = ""
    """As in the camera's facts."""


class BurstStatus(Struct, frozen=True, kw_only=True):
    """Burst that is ordered, under way or just saved."""

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
    """Whether it is a recording: `expected` counts the frames until now, and all that were ordered when it is
    done."""
    ended: bool = False
    """Whether a recording's last instant has passed, so that only images are still to come."""
    transfer: tuple[CameraTransfer, ...] = ()
    """Progress of each camera, by name."""
    skipped: tuple[SkippedInstant, ...] = ()
    """Instants skipped because a camera had no frame; later ones replaced them."""
    first_leader_ns: int = 0
    """First instant in leader time; 0 for a burst of an earlier run."""


class RigStatus(Struct, frozen=True, kw_only=True):
    """Status of a rig: its leader, its nodes, and its bursts."""

    leader: str
    """Address host:port that nodes join."""
    is_open: bool = False
    """Whether the rig does not authenticate machines."""
    relay: str | None = None
    """Name of the relay that sends this status because it has no leader at present; None from a leader."""
    message: str = ""
    """Message about the rig as a whole."""
    advice: str = ""
    """One sentence: why the rig is not ready and the remedy, or its accuracy."""
    now_ns: int
    period_ns: int | None
    stagger: str = ""
    """Planned order of the cameras' frames, as the option --stagger; empty if all are at one instant."""
    steps: str = ""
    """Planned steps between frames of a staggered rig: "steps of 8.33 ms"; empty for any other."""
    nodes: tuple[NodeStatus, ...] = ()
    further: int = 0
    """Number of nodes after this page, by name; `message` summarizes them."""
    burst: BurstStatus | None = None
    unsaved: tuple[BurstStatus, ...] = ()
    """Earlier bursts than `burst` whose images are still to come, without their details."""
    ahead: tuple[BurstStatus, ...] = ()
    """Bursts that begin much later, and can be cancelled."""
    sessions: tuple[str, ...] = ()
    """Paths of the newest sessions saved by this leader, newest last."""
    sessions_folder: str = ""
    """Folder of the sessions, on the leader's machine."""
    disk_free_bytes: int | None = None
    """Free space of that folder's disk."""

    @property
    def order(self) -> str:
        """The planned order in words: "stagger: even, steps of 8.33 ms"; empty if all are at one instant."""
        kind = f"{EVEN}, " if self.stagger == EVEN else ""
        return f"stagger: {kind}{self.steps}" if self.stagger else ""

    @property
    def titles(self) -> dict[str, str]:
        """What people call each node, by its name; beside the name, if they call several so."""
        return titles_of({node.name: node.camera.called(node.name) for node in self.nodes})

    @property
    def cameras(self) -> tuple[NodeStatus, ...]:
        """The nodes with a camera, without relays and clocks."""
        return tuple(node for node in self.nodes if node.camera.kind not in WITHOUT_CAMERA)


Level = Literal["info", "warning", "error"]


class LogLine(Struct, frozen=True, kw_only=True):
    """Log line for people, with its time, camera and severity."""

    unix_ns: TimeNs
    """Calendar time at its source; times of one source strictly increase."""
    text: Sentence
    camera: Text | None = None
    """Name of the node that it is about, or None."""
    level: Level = "info"


class Preview(Message, frozen=True, kw_only=True, tag="preview", omit_defaults=True):
    """Small preview image of a camera; the next one is sent after a `PreviewSeen`."""

    camera: Name
    leader_ns: TimeNs | None
    """Leader time of the frame; None while the node's clock is unknown."""
    instant_ns: TimeNs | None = None
    """Leader time of the rig's instant that it shows; None if it is only the camera's newest frame."""
    completes: bool = False
    """Whether it is the last of the previews of its instant that the leader sends to this operator."""
    width: Pixels
    """Width in pixels, as the height."""
    height: Pixels
    jpeg: Annotated[bytes, Meta(max_length=0)] = b""
    """JPEG data; it is sent as the payload, and the message itself has none."""


class NodeDetail(Message, frozen=True, kw_only=True, tag="detail"):
    """Details of a node that are too large for a status; times in ns, newest last."""

    camera: Name
    samples: Annotated[tuple[tuple[TimeNs, Count], ...], Meta(max_length=MAX_DETAILS)] = ()
    """Clock offset (leader minus local time, as of the latest one) and round-trip delay of exchanges."""
    phase_errors_ns: Annotated[tuple[TimeNs, ...], Meta(max_length=MAX_DETAILS)] = ()
    """Offsets of the latest frames from the rig's grid."""
    log: Annotated[tuple[LogLine, ...], Meta(max_length=MAX_DETAILS)] = ()
    fps: Real | None = None
    exposure_ns: Count | None = None
    gain: Real | None = None
    white_balance: tuple[Real, Real] | None = None
    """Red and blue gains relative to green."""
    controls: Annotated[tuple[ControlState, ...], Meta(max_length=16)] = ()
    """Controls as of a few seconds ago."""
    spool: FilePath = ""
    """Folder of that machine that stores images until the leader has them; empty if memory does."""
    disk_free_bytes: Count | None = None
