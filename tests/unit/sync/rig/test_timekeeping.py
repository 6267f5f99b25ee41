"""How often a client asks for the time; a node without a camera joins a leader and keeps its time."""

import random
from heapq import heappop, heappush
from itertools import pairwise

import pytest

from capture_app.common.node_state import NodeState
from capture_app.common.timeouts import LEADER_SILENT_NS
from capture_app.sync.clock.clock_filter import ClockSample
from capture_app.sync.rig.events import Joined, LeaderNotice
from capture_app.sync.rig.leader_engine import Leader, LeaderConfig
from capture_app.sync.rig.time_client import NO_ANSWER, TimeClient
from capture_app.sync.timekeeping.clock_events import ClockSynced
from capture_app.sync.timekeeping.poll_schedule import (
    EASING_INTERVALS_NS,
    EASING_SAMPLES,
    FIRST_INTERVAL_NS,
    FIRST_SAMPLES,
    POLL_INTERVAL_NS,
    SteadySchedule,
)
from capture_app.sync.timekeeping.timekeeper import Timekeeper
from capture_app.sync.wire.codec import decode
from capture_app.sync.wire.datagrams import RigConfigMessage, TimeReply, TimeRequest

S = 1_000_000_000
DELAY_NS = 1_000_000


def asked_ns(seconds: float, *, told_pace_ns: int = 0, lose_each: int = 0) -> list[int]:
    """Let a client ask a leader a millisecond away; return when its requests went out."""
    keeper = Timekeeper(7)
    told = RigConfigMessage(leader=2, anchor_leader_ns=0, period_ns=33_333_333, poll_interval_ns=told_pace_ns)
    assert told.is_possible
    keeper.follow(told, 3, 0.25, 0)
    sent_ns: list[int] = []
    replies: list[tuple[int, TimeReply]] = []
    now_ns = 0
    while now_ns < seconds * S:
        if replies and replies[0][0] <= now_ns:
            assert keeper.take_reply(replies.pop(0)[1], now_ns)
        keeper.handle_timer(now_ns)
        data = keeper.request_to_send(now_ns)
        if data is not None:
            request = decode(data)
            assert isinstance(request, TimeRequest)
            sent_ns.append(now_ns)
            if not lose_each or len(sent_ns) % lose_each:
                t1_ns = now_ns + DELAY_NS + S
                reply = TimeReply(request.client, request.sequence, request.t0_ns, t1_ns, t1_ns)
                replies.append((now_ns + 2 * DELAY_NS, reply))
        now_ns = max(now_ns + 1, min([keeper.next_timer(), *(at_ns for at_ns, _ in replies)]))
    return sent_ns


def pace_at(sent_ns: list[int], from_s: float, to_s: float) -> float:
    """Mean time in ns between two requests that went out in this span of seconds."""
    within = [t for t in sent_ns if from_s * S <= t < to_s * S]
    return (within[-1] - within[0]) / (len(within) - 1)


@pytest.mark.parametrize("lose_each", [0, 10])
def test_it_asks_in_quick_succession_then_less_and_less_often(lose_each: int) -> None:
    sent_ns = asked_ns(12.0, lose_each=lose_each)
    more = lose_each / (lose_each - 1) if lose_each else 1.0
    begin_s = 0.0
    for poll_interval_ns, count in (
        (FIRST_INTERVAL_NS, FIRST_SAMPLES),
        *((poll_interval_ns, EASING_SAMPLES) for poll_interval_ns in EASING_INTERVALS_NS),
    ):
        end_s = begin_s + count * poll_interval_ns * more / S
        assert pace_at(sent_ns, begin_s + 0.1, end_s - 0.1) == pytest.approx(poll_interval_ns, rel=0.03)
        begin_s = end_s
    assert pace_at(sent_ns, begin_s + 0.2, 12.0) == pytest.approx(POLL_INTERVAL_NS, rel=0.03)


def test_a_leader_of_many_is_asked_no_more_often_than_it_says() -> None:
    sent_ns = asked_ns(12.0, told_pace_ns=100_000_000)
    synced_s = FIRST_SAMPLES * FIRST_INTERVAL_NS / S
    assert pace_at(sent_ns, synced_s + 0.2, 12.0) == pytest.approx(100_000_000, rel=0.03)


AHEAD_NS = 7 * S
STEADY_NS = 10_000_000
ADDRESS = ("client", 0)


def talk(client: TimeClient, leader: Leader, seconds: float) -> None:
    """Let both talk over a link of a millisecond each way; the leader's clock is ahead."""
    rng, now_ns, sent = random.Random(1), 0, 0
    heap: list[tuple[int, int, bytes, bool]] = []
    while now_ns < seconds * S:
        client.handle_timer(now_ns)
        leader.handle_timer(now_ns + AHEAD_NS)
        outgoing = [(data, True) for data in client.datagrams_to_send(now_ns)]
        outgoing += [(data, False) for data, _ in leader.datagrams_to_send(now_ns + AHEAD_NS)]
        for data, up in outgoing:
            sent += 1
            heappush(heap, (now_ns + 1_000_000 + rng.randrange(100_000), sent, data, up))
        if heap and heap[0][0] <= client.next_timer():
            now_ns, _, data, up = heappop(heap)
            if up:
                leader.receive_datagram(data, ADDRESS, now_ns + AHEAD_NS)
            else:
                client.receive_datagram(data, now_ns)
        else:
            now_ns = max(now_ns, client.next_timer())


def test_a_node_joins_requests_at_its_interval_and_reports_every_sample() -> None:
    samples: list[ClockSample] = []
    schedule = SteadySchedule(first_interval_ns=STEADY_NS, easing_intervals_ns=(), poll_interval_ns=STEADY_NS)
    timekeeper = Timekeeper(5, schedule, samples=samples)
    client = TimeClient("probe", 9, timekeeper)
    leader = Leader(LeaderConfig(1, 47), random.Random(2))
    talk(client, leader, 5.0)
    assert client.state is NodeState.READY
    assert client.time_map is not None
    assert abs(client.time_map.leader_from_local(5 * S) - 5 * S - AHEAD_NS) < 100_000
    assert len(samples) == timekeeper.clock.samples
    assert timekeeper.requests - len(timekeeper.outstanding) == len(samples)
    spacings = [b.t0_ns - a.t0_ns for a, b in pairwise(samples[50:])]
    assert abs(sum(spacings) / len(spacings) - STEADY_NS) < STEADY_NS / 50
    assert next(iter(leader.roster.by_name())).report.samples > 100, "its heartbeats tell of it"
    events = list(iter(client.next_event, None))
    assert events[0] == Joined(47, 1)
    assert [type(event) for event in events[1:]] == [ClockSynced]


def test_a_node_notices_a_lost_leader_and_keeps_its_map() -> None:
    client = TimeClient("probe", 9, Timekeeper(5))
    talk(client, Leader(LeaderConfig(1, 0), random.Random(2)), 2.0)
    client.handle_timer(2 * S + LEADER_SILENT_NS)
    assert client.state is NodeState.JOINING
    assert client.time_map is not None
    *_, last = iter(client.next_event, None)
    assert last == LeaderNotice("lost", "the leader is silent")


def test_it_says_why_it_waits_where_no_leader_answers_and_no_more_once_one_does() -> None:
    client = TimeClient("probe", 9, Timekeeper(5))
    client.handle_timer(0)
    assert client.report(0).message == ""
    while (now_ns := client.next_timer()) < 3 * S:
        client.handle_timer(now_ns)
    assert client.report(3 * S).message == NO_ANSWER
    talk(client, Leader(LeaderConfig(1, 0), random.Random(2)), 2.0)
    assert client.report(2 * S).message == ""
