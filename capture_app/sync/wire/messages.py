"""Messages between nodes over datagrams: time, joining, heartbeats, bursts, a relay's clock map."""

from math import isfinite
from typing import Annotated

from msgspec import Meta, Struct

from capture_app.common.camera_facts import CameraFacts, PhaseControl, TimestampSource
from capture_app.common.names import Name
from capture_app.common.node_state import CLOCK_ONLY, NodeState
from capture_app.sync.clock.time_map import TimeMap

MAX_DEPTH = 8
"""Most clocks between a node's and the root's."""
Error = Annotated[float, Meta(ge=0.0, le=1e18)]
SkewError = Annotated[float, Meta(ge=0.0, le=1.0)]
MOST_TEXT = 200
MOST_REPORTS, MOST_OTHERS = 10, 200
"""That a relay's message carries: so many fit into a datagram."""
CLOCK = CameraFacts(
    kind=CLOCK_ONLY,
    model="",
    width=0,
    height=0,
    period_ns=33_333_333,
    phase_control=PhaseControl.NONE,
    timestamp_source=TimestampSource.UNKNOWN,
)
"""What such a node says of the camera that it has not."""
PROBE_NUMBER = 0
"""The number in a liveness probe, which no client has: a leader that answers that it is unknown is there."""
MIN_PERIOD_NS = 100_000
MAX_PERIOD_NS = 60_000_000_000
"""Frame periods that a rig can have: 10,000 fps to one a minute."""


class UpstreamMap(Struct, frozen=True, array_like=True):
    """A relay's map from its own clock to the root's, as it goes over the wire; times in ns.

    A relay's time replies carry its own clock, which never jumps; its clients add this to what they find.
    `path` names the instances from the root to the relay, so that no relay follows itself.
    """

    path: Annotated[tuple[int, ...], Meta(min_length=1, max_length=MAX_DEPTH)]
    epoch_local_ns: int
    offset_ns: Annotated[int, Meta(ge=-(2**62), le=2**62)]
    skew: Annotated[float, Meta(ge=-0.01, le=0.01)]
    uncertainty_ns: Error
    hard_bound_ns: Error
    skew_uncertainty: SkewError
    skew_bound: SkewError
    drift_uncertainty: SkewError = 0.0

    @property
    def is_finite(self) -> bool:
        """Whether all of its values are numbers."""
        values = (getattr(self, name) for name in _SHARED_FIELDS)
        return all(isfinite(value) for value in values if isinstance(value, float))

    def time_map(self) -> TimeMap:
        """The map from the relay's clock to the root's."""
        fields = {name: getattr(self, name) for name in _SHARED_FIELDS}
        return TimeMap(**fields, samples=0, round_trip_ns=0)


_SHARED_FIELDS = UpstreamMap.__struct_fields__[1:]
"""All but the path: fields that a time map has, too."""


def upstream_map(path: tuple[int, ...], time_map: TimeMap) -> UpstreamMap:
    """Return the message form of the time map of a relay with that path."""
    return UpstreamMap(path, *(getattr(time_map, name) for name in _SHARED_FIELDS))


Text = Annotated[str, Meta(max_length=MOST_TEXT)]
Number = Annotated[int, Meta(ge=0, le=0xFFFF_FFFF)]
"""The number of a client, as time messages carry it."""
Others = Annotated[tuple[Number, ...], Meta(max_length=MOST_OTHERS)]
Pin = Annotated[str, Meta(pattern="^[a-z2-7-]{0,39}$")]
"""By which a machine is known; empty in a rig that asks nobody."""


class TimeRequest(Struct, frozen=True):
    """A client asks for the leader's time; `t0_ns` is its own when it sent this."""

    client: int
    sequence: int
    t0_ns: int


class TimeReply(Struct, frozen=True):
    """The leader's answer: request received at `t1_ns` and answered at `t2_ns`, leader time."""

    client: int
    sequence: int
    t0_ns: int
    t1_ns: int
    t2_ns: int


class Hello(Struct, frozen=True, tag="hello"):
    """A client wants to join; `instance` tells one run of it from the next."""

    name: Name
    instance: int
    camera: CameraFacts
    via: Name | None = None
    """The relay that it joined, where a relay passes this on; None where the client sends it itself."""
    pin: Pin = ""
    """That of its machine, as a relay has seen it; what a client says of itself does not count."""


class RigConfigMessage(Struct, frozen=True, kw_only=True, array_like=True):
    """A rig's configuration as a leader, or a relay, tells it to all its clients; times in ns."""

    leader: int
    """The run of the leader, or of the relay."""
    anchor_leader_ns: int
    """An instant of the rig's grid, which has one each `period_ns`."""
    period_ns: int
    align_row: Annotated[float, Meta(ge=0.0, le=1.0)] | None = None
    """Share of the height at which a row's middle of exposure is aligned; None for the first row's start."""
    meeting_leader_ns: int | None = None
    """When streams that can only be restarted should suit the grid, or be restarted; None: none need be."""
    pace_ns: Annotated[int, Meta(ge=0, le=60_000_000_000)] = 0
    """Mean time between two time requests of one client that this leader can bear; 0: as it likes."""
    upstream: UpstreamMap | None = None
    """A relay's map from its clock to the root's."""
    in_holdover: bool = False
    """This relay, or one above it, has lost its leader: it keeps the time, but brings no bursts."""
    continues: UpstreamMap | None = None
    """The root carries on the time of a leader that is gone, which is the path: from its own to that time."""

    @property
    def is_possible(self) -> bool:
        """Whether it can be right."""
        above = self.upstream
        return MIN_PERIOD_NS <= self.period_ns <= MAX_PERIOD_NS and (above is None or above.is_finite)

    @property
    def path(self) -> tuple[int, ...]:
        """Instances from the root to this leader."""
        return (self.leader,) if self.upstream is None else (*self.upstream.path, self.leader)

    def root_map(self, own: TimeMap) -> TimeMap:
        """Return the map to the root's clock; `own` is the one to this leader's."""
        return own if self.upstream is None else own.chained_to(self.upstream.time_map())


class Welcome(Struct, frozen=True, tag="welcome"):
    """The leader took a client in."""

    instance: int
    """The client's run, as its hello told it."""
    client: Number
    """The client's number, here and in all further messages."""
    transfer_port: int
    """TCP port of the leader that images go to."""
    config: RigConfigMessage
    slot: Annotated[float, Meta(ge=0.0, lt=1.0)] = 0.0
    """The part of its pace at which a client sends its time requests, in leader time."""


class JoinRefusal(Struct, frozen=True, tag="join-refusal"):
    """The leader did not take a client in, and why; the client may ask again."""

    instance: int
    reason: Text
    retry_here: bool = False
    """It will be able to soon: ask again here, not another leader."""


class Report(Struct, frozen=True, kw_only=True, array_like=True):
    """A client's own view of itself, sent with each heartbeat; times in ns."""

    state: NodeState
    message: Text = ""
    """Why it is not ready, what it does about it and what a person can do, in one sentence."""
    offset_ns: int | None = None
    skew_ppm: float | None = None
    uncertainty_ns: int | None = None
    hard_bound_ns: int | None = None
    round_trip_ns: int | None = None
    samples: int = 0
    phase_error_ns: int | None = None
    period_ns: int | None = None
    drift_ppm: float | None = None
    corrections: int = 0
    frames: int = 0
    drops: int = 0
    frame_leader_ns: int | None = None
    """Leader time of the aligned moment of a frame near now; None while the phase is not known."""
    tolerance_ns: int = 0
    """Largest phase error that this client does not correct: what was asked for, or what its stamps allow."""
    stamp_quantum_ns: int = 0
    """Step that the camera's timestamps come in, 0 where it is too fine to matter."""
    slewing_ppm: float | None = None
    """By how much this host makes its clock run faster than usual, as it says itself; None if it does not."""


class Heartbeat(Struct, frozen=True, tag="heartbeat"):
    """A client is alive; what it reports of itself."""

    client: int
    report: Report


class MemberReports(Struct, frozen=True, tag="member-reports"):
    """A relay sums up its members: those that have news, and the others in turn; all else is as it was.

    While the relay is heard its members are there; of one that is lost it says so until that is known.
    """

    reports: Annotated[tuple[tuple[Number, Report], ...], Meta(max_length=MOST_REPORTS)]
    """By the numbers of the members."""


class HeartbeatAck(Struct, frozen=True, tag="heartbeat-ack"):
    """The leader is alive and knows the client; its configuration, in case the client missed a change."""

    client: int
    config: RigConfigMessage


class UnknownMember(Struct, frozen=True, tag="unknown-member"):
    """The leader does not know this client, as it was restarted or had lost it: join again."""

    client: int
    stops: bool = False
    """It is about to stop: join another one, if there is one."""


class Trigger(Struct, frozen=True, tag="trigger"):
    """Save the frames nearest to first + k * step, k < count, leader time; past or future.

    `leader` is the run of the tree's root that ordered it: within that run its number tells a burst. A count
    of 0 takes the burst of that number back.
    """

    client: int
    leader: int
    burst: int
    first_leader_ns: int
    step_ns: int
    count: int
    spare: int = 0
    """How many of the last frames are wanted only while it is not known that the others will do."""
    streamed: bool = False
    """Send the frames as they come; the same burst again with a lower count ends it earlier."""
    video: bool = False
    """They go into a video."""
    others: Others = ()
    """Further clients below the same relay, which passes it on."""


class TriggerAck(Struct, frozen=True, tag="trigger-ack"):
    """A client will save the burst, or says why it cannot."""

    client: int
    leader: int
    burst: int
    refusal: Text = ""
    others: Others = ()
    """Further clients below the same relay that say so, too."""


class Notice(Struct, frozen=True, tag="notice"):
    """What whoever looks after a client should know."""

    client: int
    text: Text


class Goodbye(Struct, frozen=True, tag="goodbye"):
    """A client leaves of its own will."""

    client: int


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
