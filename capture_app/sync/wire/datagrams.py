"""Messages between nodes over datagrams: time, joining, heartbeats, bursts, a relay's clock map."""

from math import isfinite, isnan
from typing import Annotated
from zlib import crc32

from msgspec import Meta, Struct

from capture_app.common.bounds import Count, Instance, Number, Positive, Ppm, Text, TimeNs
from capture_app.common.camera_facts import CameraFacts, PhaseControl, TimestampSource
from capture_app.common.names import Name
from capture_app.common.node_state import CLOCK_ONLY, NodeState
from capture_app.sync.clock.time_map import TimeMap

MAX_DEPTH = 8
"""Maximum number of clocks between a node's and the root's."""
Error = Annotated[float, Meta(ge=0.0, le=1e18)]
SkewError = Annotated[float, Meta(ge=0.0, le=1.0)]
MAX_REPORTS, MAX_OTHERS = 10, 200
"""Maximum entries of a relay's message: as many as fit into a datagram."""
CLOCK = CameraFacts(
    kind=CLOCK_ONLY,
    model="",
    width=0,
    height=0,
    period_ns=33_333_333,
    phase_control=PhaseControl.NONE,
    timestamp_source=TimestampSource.UNKNOWN,
)
"""Placeholder camera description of a node without a camera."""
PROBE_NUMBER = 0
"""Client number in a liveness probe, which no client has; a leader that answers "unknown" is alive."""
MAX_DELAYS = 64
"""Maximum planned delays in a message: as many as fit into a datagram beside the rest of a configuration."""
MIN_PERIOD_NS, MAX_PERIOD_NS = 100_000, 60_000_000_000
"""Minimum and maximum frame period of a rig: 10,000 fps to one frame a minute."""


class UpstreamMap(Struct, frozen=True, array_like=True):
    """Message form of a relay's map from its own clock to the root's; times in ns.

    A relay's time replies carry its own clock, which never jumps. Its clients chain this map to their map of
    the relay's clock. `path` names the instances from the root to the relay, so that no relay follows itself.
    """

    path: Annotated[tuple[Number, ...], Meta(min_length=1, max_length=MAX_DEPTH)]
    epoch_local_ns: TimeNs
    offset_ns: Annotated[int, Meta(ge=-(2**62), le=2**62)]
    skew: Annotated[float, Meta(ge=-0.01, le=0.01)]
    uncertainty_ns: Error
    hard_bound_ns: Error
    skew_uncertainty: SkewError
    skew_bound: SkewError
    drift_uncertainty: SkewError = 0.0

    @property
    def is_finite(self) -> bool:
        """Whether all values are finite numbers."""
        return all(isfinite(getattr(self, name)) for name in _SHARED_FIELDS)

    def time_map(self) -> TimeMap:
        """Return the map from the relay's clock to the root's."""
        return TimeMap(**{name: getattr(self, name) for name in _SHARED_FIELDS}, samples=0, round_trip_ns=0)


_SHARED_FIELDS = UpstreamMap.__struct_fields__[1:]
"""Fields shared with a time map: all but the path."""


def upstream_map(path: tuple[int, ...], time_map: TimeMap) -> UpstreamMap:
    """Return the message form of the time map of a relay at `path`."""
    return UpstreamMap(path, *(getattr(time_map, name) for name in _SHARED_FIELDS))


Others = Annotated[tuple[Number, ...], Meta(max_length=MAX_OTHERS)]
Pin = Annotated[str, Meta(pattern="^[a-z2-7-]{0,39}$")]
"""Identifier of a machine; empty in a rig that does not authenticate machines."""


class TimeRequest(Struct, frozen=True):
    """Client's request for the leader's time; `t0_ns` is the send time on the client's clock."""

    client: int
    sequence: int
    t0_ns: int


class TimeReply(Struct, frozen=True):
    """Leader's reply: request received at `t1_ns` and answered at `t2_ns`, leader time."""

    client: int
    sequence: int
    t0_ns: int
    t1_ns: int
    t2_ns: int


class Hello(Struct, frozen=True, tag="hello"):
    """Client's request to join; `instance` identifies one run of the client."""

    name: Name
    instance: Instance
    camera: CameraFacts
    via: Name | None = None
    """Relay that the client joined and that forwards this; None if the client sends it itself."""
    pin: Pin = ""
    """Pin of the client's machine as its relay observed it; a client's own claim is ignored."""


class Principal(Struct, frozen=True):
    """Authenticated sender of a sealed datagram: one instance of a node, by the key issued to it."""

    name: str
    instance: int
    pin: str = ""
    """Pin of its machine's certificate."""
    is_relay: bool = False
    """Whether it may introduce other nodes."""

    def may_introduce(self, hello: Hello) -> bool:
        """Whether a hello is the node's own, or a relay's for a node below it."""
        if hello.via is not None:
            return self.is_relay
        return (hello.name, hello.instance) == (self.name, self.instance)


class RigConfigMessage(Struct, frozen=True, kw_only=True, array_like=True):
    """Configuration of a rig, as a leader or a relay sends it to all its clients; times in ns."""

    leader: Number
    """Instance of the leader, or of the relay."""
    anchor_leader_ns: TimeNs
    """An instant of the rig's grid, which has one each `period_ns`."""
    period_ns: Positive
    align_row: Annotated[float, Meta(ge=0.0, le=1.0)] | None = None
    """Row aligned by its mid-exposure, as a fraction of the height; None: the first row's start."""
    common_instant_leader_ns: TimeNs | None = None
    """Instant at which restartable streams must meet the grid, or be restarted; None: none is restarted."""
    poll_interval_ns: Annotated[int, Meta(ge=0, le=60_000_000_000)] = 0
    """Minimum mean interval between one client's time requests that this leader accepts; 0 for any."""
    upstream: UpstreamMap | None = None
    """A relay's map from its clock to the root's."""
    in_holdover: bool = False
    """Whether this relay, or one above it, has lost its leader: it keeps the time but forwards no bursts."""
    continues: UpstreamMap | None = None
    """Map from the root's clock to a lost leader's, whose time the root continues; the path names it."""
    delays_ns: Annotated[dict[Number, Count], Meta(max_length=MAX_DELAYS)] | None = {}
    """Planned delays after the grid's instants by `camera_key`, 0 for all others; None: as they are now."""

    @property
    def is_possible(self) -> bool:
        """Whether all values of this configuration are plausible."""
        above = self.upstream
        return MIN_PERIOD_NS <= self.period_ns <= MAX_PERIOD_NS and (above is None or above.is_finite)

    @property
    def path(self) -> tuple[int, ...]:
        """Instances from the root to this leader."""
        return (self.leader,) if self.upstream is None else (*self.upstream.path, self.leader)

    def root_map(self, own: TimeMap) -> TimeMap:
        """Return the map to the root's clock; `own` maps to this leader's clock."""
        return own if self.upstream is None else own.chained_to(self.upstream.time_map())


def camera_key(name: str) -> int:
    """Return the number by which a configuration's delays name a camera: names are up to 64 bytes long."""
    return crc32(name.encode())


class Welcome(Struct, frozen=True, tag="welcome"):
    """Leader's confirmation that a client has joined."""

    instance: Instance
    """Instance of the client, from its hello."""
    client: Number
    """Number assigned to the client, used in all further messages."""
    transfer_port: Annotated[int, Meta(ge=0, le=65535)]
    """TCP port of the leader to which images are sent."""
    config: RigConfigMessage
    slot: Annotated[float, Meta(ge=0.0, lt=1.0)] = 0.0
    """Position of a client's time requests within its request interval, in leader time."""


class JoinRefusal(Struct, frozen=True, tag="join-refusal"):
    """Leader's refusal of a client, with the reason; the client may ask again."""

    instance: Instance
    reason: Text
    retry_here: bool = False
    """Whether this leader can soon admit the client, which should retry here and not at another leader."""


class Report(Struct, frozen=True, kw_only=True, array_like=True):
    """Status of a client, sent with each heartbeat; times in ns."""

    state: NodeState
    message: Text = ""
    """One sentence: why the client is not ready, what it does about it and what the operator can do."""
    offset_ns: TimeNs | None = None
    skew_ppm: Ppm | None = None
    uncertainty_ns: Count | None = None
    hard_bound_ns: Count | None = None
    round_trip_ns: Count | None = None
    samples: Count = 0
    phase_error_ns: TimeNs | None = None
    period_ns: Positive | None = None
    drift_ppm: Ppm | None = None
    corrections: Count = 0
    frames: Count = 0
    drops: Count = 0
    frame_leader_ns: TimeNs | None = None
    """Leader time of the aligned moment of a frame close to now, without its planned delay; None while the
    phase is unknown."""
    tolerance_ns: Count = 0
    """Largest phase error that is not corrected: as requested, or what the camera's timestamps allow."""
    stamp_quantum_ns: Count = 0
    """Step of the camera's timestamps; 0 if it is negligible."""
    uploads_wait: bool = False
    """Whether no stream for its images reaches the leader; `message` of a ready camera then says why."""

    def __post_init__(self) -> None:
        """Raise ValueError for a rate that is not a number, which passes every bound."""
        if any(rate is not None and isnan(rate) for rate in (self.skew_ppm, self.drift_ppm)):
            raise ValueError("a rate is not a number")


class Heartbeat(Struct, frozen=True, tag="heartbeat"):
    """Periodic message of a live client, with its status report."""

    client: Number
    report: Report


class MemberReports(Struct, frozen=True, tag="member-reports"):
    """Relay's summary of its members: changed ones, and the others in turn; the rest are unchanged.

    While the relay is alive, its members count as alive. The relay reports a lost member until the loss is
    acknowledged.
    """

    reports: Annotated[tuple[tuple[Number, Report], ...], Meta(max_length=MAX_REPORTS)]
    """Reports with the members' numbers."""


class HeartbeatAck(Struct, frozen=True, tag="heartbeat-ack"):
    """Leader's answer to a heartbeat, with its configuration in case the client missed a change."""

    client: Number
    config: RigConfigMessage


class UnknownMember(Struct, frozen=True, tag="unknown-member"):
    """Leader's answer to a client that it does not know, which must join again.

    The leader was restarted, or had lost the client.
    """

    client: Number
    stops: bool = False
    """Whether the leader is about to stop: the client should join another one, if any."""


class Trigger(Struct, frozen=True, tag="trigger"):
    """Order to save the frames nearest to first + k * step, k < count, leader time; past or future.

    `leader` is the instance of the root that ordered the burst; the burst's number is unique within it. A
    count of 0 cancels the burst of that number.
    """

    client: Number
    leader: Number
    burst: Number
    first_leader_ns: TimeNs
    step_ns: Count
    count: Number
    spare: Number = 0
    """Number of last frames that are only needed until the others are known to suffice."""
    streamed: bool = False
    """Whether to send the frames as they arrive; the same burst with a lower count ends it earlier."""
    video: bool = False
    """Whether the frames are recorded as a video."""
    others: Others = ()
    """Further clients below the same relay, which forwards the order to them."""
    root: Number = 0
    """Instance of the root that asks for the rest of a burst which its earlier run ordered; else 0."""


class TriggerAck(Struct, frozen=True, tag="trigger-ack"):
    """Client's answer to a trigger: it will save the burst, or the reason why it cannot."""

    client: Number
    leader: Number
    burst: Number
    refusal: Text = ""
    others: Others = ()
    """Further clients below the same relay with the same answer."""


class Notice(Struct, frozen=True, tag="notice"):
    """Message for a client's operator."""

    client: Number
    text: Text


class Goodbye(Struct, frozen=True, tag="goodbye"):
    """Client's announcement that it leaves."""

    client: Number


ControlMessage = (
    Hello
    | Welcome
    | JoinRefusal
    | Heartbeat
    | MemberReports
    | HeartbeatAck
    | UnknownMember
    | Trigger
    | TriggerAck
    | Notice
    | Goodbye
)
