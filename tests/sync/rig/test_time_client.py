"""A node without a camera joins a leader, keeps its time, and tells every sample."""

import random
from heapq import heappop, heappush
from itertools import pairwise

from capture_app.sync.clock.clock_filter import ClockSample
from capture_app.sync.rig.events import ClockSynced, Joined, LeaderLost
from capture_app.sync.rig.leader import Leader, LeaderConfig
from capture_app.sync.rig.poll_schedule import SteadySchedule
from capture_app.sync.rig.time_client import LEADER_SILENT_NS, TimeClient
from capture_app.sync.rig.timekeeper import Timekeeper
from capture_app.sync.wire.messages import NodeState

S = 1_000_000_000
AHEAD_NS = 7 * S
PACE_NS = 10_000_000
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


def test_it_joins_keeps_the_time_at_its_pace_and_tells_every_sample() -> None:
    samples: list[ClockSample] = []
    schedule = SteadySchedule(first_pace_ns=PACE_NS, easing_paces_ns=(), pace_ns=PACE_NS)
    timekeeper = Timekeeper(5, schedule, on_sample=samples.append)
    client = TimeClient("probe", 9, timekeeper)
    leader = Leader(LeaderConfig(1, 47), random.Random(2))
    talk(client, leader, 5.0)
    assert client.state is NodeState.READY
    assert client.time_map is not None
    assert abs(client.time_map.leader_from_local(5 * S) - 5 * S - AHEAD_NS) < 100_000
    assert len(samples) == timekeeper.clock.samples
    assert timekeeper.requests - timekeeper.outstanding == len(samples)
    spacings = [b.t0_ns - a.t0_ns for a, b in pairwise(samples[50:])]
    assert abs(sum(spacings) / len(spacings) - PACE_NS) < PACE_NS / 50
    assert next(iter(leader.clients(0))).report.samples > 100, "its heartbeats tell of it"
    events = list(iter(client.next_event, None))
    assert events[0] == Joined(47, 1)
    assert [type(event) for event in events[1:]] == [ClockSynced]


def test_it_notices_that_the_leader_is_gone_and_keeps_what_it_knows() -> None:
    client = TimeClient("probe", 9, Timekeeper(5))
    talk(client, Leader(LeaderConfig(1, 0), random.Random(2)), 2.0)
    client.handle_timer(2 * S + LEADER_SILENT_NS)
    assert client.state is NodeState.JOINING
    assert client.time_map is not None
    *_, last = iter(client.next_event, None)
    assert last == LeaderLost("the leader is silent")
