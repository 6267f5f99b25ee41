"""What liars might send a member or a relay, as hypothesis strategies."""

import math

from hypothesis import strategies as st

from capture_app.common.camera_facts import CameraFacts, PhaseControl, TimestampSource
from capture_app.common.node_state import NodeState
from capture_app.sync.sync_engine import Address
from capture_app.sync.wire.codec import Message
from capture_app.sync.wire.datagrams import (
    Goodbye,
    Heartbeat,
    HeartbeatAck,
    Hello,
    JoinRefusal,
    MemberReports,
    Report,
    RigConfigMessage,
    TimeReply,
    TimeRequest,
    Trigger,
    TriggerAck,
    UnknownMember,
    UpstreamMap,
    Welcome,
)

S = 1_000_000_000
INSTANCE, HONEST = 77, 99
PARENTS: tuple[Address, ...] = (("a", 1), ("b", 1), ("c", 1))
UNKNOWN_PEER: Address = ("stranger", 1)
OFFSET_NS = 123_456_789_012
ONE_WAY_NS = 700_000
RECOVERED_NS = 400 * S
"""Of virtual time: a pace of a minute that was forged, all parents asked in turn, and the first exchanges."""

i64 = st.integers(-(2**63), 2**63 - 1)
u32 = st.integers(0, 2**32 - 1)
numbers = st.sampled_from([0, 1, INSTANCE, HONEST, 2**32 - 1]) | i64
periods = st.sampled_from([33_333_333] * 8 + [0, 1, -1, 2**63 - 1])
errors = st.floats(0.0, 1e18)
slopes = st.floats(0.0, 1.0) | st.just(1e18)
paces = st.integers(0, 60 * S)
paths = st.lists(numbers, min_size=1, max_size=8).map(tuple)
bounds = (errors, errors, slopes, slopes, errors)
upstreams = st.none() | st.builds(UpstreamMap, paths, i64, i64, st.floats(-0.01, 0.01), *bounds)
config = st.builds(
    RigConfigMessage,
    leader=numbers,
    anchor_leader_ns=i64,
    period_ns=periods,
    poll_interval_ns=paces,
    upstream=upstreams,
    in_holdover=st.booleans(),
)
slots = st.floats(0.0, 1.0, exclude_max=True) | st.just(math.nan)
cameras = st.builds(
    CameraFacts,
    kind=st.sampled_from(["clock", "relay", "sim"]),
    model=st.just(""),
    width=st.integers(0, 2**63 - 1),
    height=st.integers(0, 2**63 - 1),
    period_ns=periods,
    phase_control=st.sampled_from(PhaseControl),
    timestamp_source=st.sampled_from(TimestampSource),
)
reports = st.builds(Report, state=st.sampled_from(list(NodeState)), frame_leader_ns=st.none() | i64)
from_parents: st.SearchStrategy[Message] = st.one_of(
    st.builds(Welcome, st.just(INSTANCE), u32 | i64, i64, config, slots),
    st.builds(HeartbeatAck, numbers, config),
    st.builds(JoinRefusal, st.just(INSTANCE) | i64, st.sampled_from(["no", "never"]), st.booleans()),
    st.builds(UnknownMember, numbers),
    st.builds(Trigger, numbers, numbers, i64, i64, i64, i64),
    st.builds(Trigger, numbers, numbers, i64, i64, i64, i64, others=st.lists(u32, max_size=3).map(tuple)),
    st.builds(TimeReply, u32, u32, i64, i64, i64),
)
from_clients: st.SearchStrategy[Message] = st.one_of(
    st.builds(Hello, st.sampled_from(["x", "y", "relay"]), numbers, cameras),
    st.builds(Heartbeat, numbers, reports),
    st.builds(MemberReports, st.lists(st.tuples(u32, reports), max_size=3).map(tuple)),
    st.builds(TimeRequest, u32, u32, i64),
    st.builds(TriggerAck, numbers, numbers, i64),
    st.builds(TriggerAck, numbers, numbers, i64, others=st.lists(u32, max_size=3).map(tuple)),
    st.builds(Goodbye, numbers),
)
addresses = st.sampled_from([*PARENTS, UNKNOWN_PEER])


def welcome(leader: int, number: int, upstream: UpstreamMap | None = None) -> Welcome:
    config = RigConfigMessage(leader=leader, anchor_leader_ns=0, period_ns=33_333_333, upstream=upstream)
    return Welcome(INSTANCE, number, 0, config)
