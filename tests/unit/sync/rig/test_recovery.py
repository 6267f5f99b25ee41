"""Whatever a member or a relay was told, and whenever: with an honest leader it soon knows the time."""

import random
from collections.abc import Callable
from heapq import heappop, heappush

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    precondition,
    rule,
    run_state_machine_as_test,
)
from msgspec import structs

from capture_app.common.bounds import CENTURY_NS
from capture_app.common.node_state import NodeState
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.rig.leader_engine import Leader, LeaderConfig
from capture_app.sync.rig.rig_config import RequestedConfig
from capture_app.sync.sync_engine import Address
from capture_app.sync.timekeeping.timekeeper import MAX_EVENTS, OUTSTANDING, Timekeeper
from capture_app.sync.tree.member import TreeMember
from capture_app.sync.tree.relay_engine import OF_CAMERAS, Relay
from capture_app.sync.wire.codec import Message, decode, encode
from capture_app.sync.wire.datagrams import (
    Heartbeat,
    HeartbeatAck,
    TimeReply,
    Trigger,
    UnknownMember,
    UpstreamMap,
)
from tests.unit.sync.rig.forged_messages import (
    HONEST,
    INSTANCE,
    OFFSET_NS,
    ONE_WAY_NS,
    PARENTS,
    RECOVERED_NS,
    UNKNOWN_PEER,
    S,
    addresses,
    from_clients,
    from_parents,
    i64,
    slopes,
    u32,
    welcome,
)

clocks = st.sampled_from([2**63 - 1, 2**62 - 41, CENTURY_NS, -(2**62), 0, OFFSET_NS])


class FollowerAmongLiars(RuleBasedStateMachine):
    """A member among liars; after each sequence an honest leader takes the place of one of its parents."""

    node: TreeMember | Relay
    member: TreeMember

    @initialize(start_ns=st.integers(-(2**60), 2**60), seed=u32)
    def start(self, start_ns: int, seed: int) -> None:
        self.now_ns, self.seed = start_ns, seed
        self.asked: list[tuple[int, int, int]] = []
        self.build(random.Random(seed))

    def build(self, rng: random.Random) -> None:
        self.node = self.member = TreeMember("me", INSTANCE, PARENTS, rng)

    @rule(data=st.binary(max_size=80), at=addresses)
    def noise(self, data: bytes, at: Address) -> None:
        self.hear(data, at)

    @rule(message=from_parents, at=addresses, mine=st.booleans())
    def forged(self, message: Message, at: Address, mine: bool) -> None:
        number = self.member.time.number
        if mine:
            at = self.member.leader
            if number is not None and isinstance(message, TimeReply | HeartbeatAck | UnknownMember | Trigger):
                message = structs.replace(message, client=number)
        self.hear(encode(message), at)

    @rule(message=from_clients, at=addresses)
    def of_a_client(self, message: Message, at: Address) -> None:
        self.hear(encode(message), at)

    @precondition(lambda self: self.asked)
    @rule(t1_ns=i64, takes_ns=st.integers(0, S), delay_ns=st.integers(0, 200_000_000))
    def lie(self, t1_ns: int, takes_ns: int, delay_ns: int) -> None:
        client, sequence, t0_ns = self.asked.pop()
        self.now_ns = max(self.now_ns, min(t0_ns + delay_ns, 2**61))
        t2_ns = min(t1_ns + takes_ns, 2**63 - 1)
        self.hear(encode(TimeReply(client, sequence, t0_ns, t1_ns, t2_ns)), self.member.leader)

    @rule(
        offset_ns=st.sampled_from([2**63 - 1, 2**62 - 41, CENTURY_NS, -(2**62), 0, OFFSET_NS]) | i64,
        turns=st.integers(280, 320),
    )
    def lie_for_long(self, offset_ns: int, turns: int) -> None:
        """A parent whose clock is what it likes, and which is followed."""
        if self.member.time.number is None:
            self.hear(encode(welcome(HONEST, 3)), self.member.leader)
        for _ in range(turns):
            self.follow_its_timers(1)
            for client, sequence, t0_ns in self.asked:
                t1_ns = max(-(2**63), min(t0_ns + offset_ns, 2**63 - 1))
                self.now_ns += 1_000_000
                self.hear(encode(TimeReply(client, sequence, t0_ns, t1_ns, t1_ns)), self.member.leader)
            self.asked = []

    @rule(wait_ns=st.integers(0, 100_000_000) | st.integers(0, 200 * S) | st.integers(0, 2**58))
    def wait(self, wait_ns: int) -> None:
        self.now_ns = min(self.now_ns + wait_ns, 2**61)
        self.turn()

    @rule(turns=st.integers(1, 60))
    def follow_its_timers(self, turns: int) -> None:
        for _ in range(turns):
            due_ns = self.node.next_timer()
            if due_ns >= 2**61:
                return
            self.now_ns = max(self.now_ns, due_ns)
            self.turn()

    def hear(self, data: bytes, at: Address) -> None:
        self.node.receive_datagram(data, at, self.now_ns)
        self.send()

    def turn(self) -> None:
        self.node.handle_timer(self.now_ns)
        self.send()

    def send(self) -> None:
        for data, _ in self.node.datagrams_to_send(self.now_ns):
            self.note(data)
        assert len(self.member.time.timekeeper.outstanding) <= OUTSTANDING
        assert not self.node.datagrams_to_send(self.now_ns), "all that was to be said has been"
        assert len(self.asked) <= 1000

    def note(self, data: bytes) -> None:
        if data[3] == 1:
            client, sequence, t0_ns = (
                int.from_bytes(data[a:b], signed=b == 20) for a, b in ((4, 8), (8, 12), (12, 20))
            )
            self.asked = [*self.asked[-9:], (client, sequence, t0_ns)]

    def teardown(self) -> None:
        if hasattr(self, "node"):
            events = list(iter(self.member.time.next_event, None))
            assert len(events) <= MAX_EVENTS
            honest = PARENTS[self.seed % len(PARENTS)]
            peers: dict[Address, TreeMember | Relay | Leader] = {("me", 1): self.node}
            peers[honest] = Leader(
                LeaderConfig(HONEST, 0, RequestedConfig(period_ns=33_333_333)), random.Random(self.seed)
            )
            self.recover(peers, honest)

    def recover(self, peers: dict[Address, TreeMember | Relay | Leader], honest: Address) -> None:
        run(peers, honest, self.now_ns, lambda: self.knows(self.member))

    def knows(self, member: TreeMember) -> bool:
        time_map = member.time.time_map
        if (
            member.time.state is not NodeState.READY
            or time_map is None
            or member.time.timekeeper.path[0] != HONEST
        ):
            return False
        error_ns = abs(time_map.offset_ns - OFFSET_NS)
        return error_ns <= min(2 * ONE_WAY_NS, time_map.hard_bound_ns)


class RelayAmongLiars(FollowerAmongLiars):
    """A relay among liars above it and below it; in the end a client of its own has the time, too."""

    def build(self, rng: random.Random) -> None:
        self.member = TreeMember("me", INSTANCE, PARENTS, rng, OF_CAMERAS)
        self.node = Relay(self.member, LeaderConfig(0, 0), rng)

    def recover(self, peers: dict[Address, TreeMember | Relay | Leader], honest: Address) -> None:
        client = TreeMember("client", 5, (("me", 1),), random.Random(self.seed))
        peers["client", 1] = client
        run(peers, honest, self.now_ns, lambda: self.knows(client) and self.knows(self.member))
        assert client.time.timekeeper.path == (HONEST, INSTANCE)


def run(
    peers: dict[Address, TreeMember | Relay | Leader], honest: Address, now_ns: int, done: Callable[[], bool]
) -> None:
    """Let all talk until it is done; all clocks but the honest leader's are one."""
    end_ns = now_ns + RECOVERED_NS
    heap: list[tuple[int, int, bytes, Address, Address]] = []
    sent = 0

    def act(address: Address, data: bytes | None = None, sender: Address = UNKNOWN_PEER) -> None:
        nonlocal sent
        peer, local_ns = peers[address], now_ns + (OFFSET_NS if address == honest else 0)
        if data is None:
            peer.handle_timer(local_ns)
        else:
            peer.receive_datagram(data, sender, local_ns)
        for outgoing, to in peer.datagrams_to_send(local_ns):
            sent += 1
            if to in peers:
                heappush(heap, (now_ns + ONE_WAY_NS, sent, outgoing, address, to))

    while not done():
        timers = []
        for address, peer in peers.items():
            due_ns = peer.next_timer()
            if due_ns is not None:
                timers.append((due_ns - (OFFSET_NS if address == honest else 0), address))
        due_ns, whose = min(timers)
        if heap and heap[0][0] <= due_ns:
            now_ns, _, data, sender, to = heappop(heap)
            act(to, data, sender)
        else:
            now_ns = max(now_ns, due_ns)
            act(whose)
        assert now_ns < end_ns, "it has not recovered"


FEW = settings(max_examples=6, stateful_step_count=12, suppress_health_check=list(HealthCheck))


@pytest.mark.parametrize("offset_ns", [2**63 - 1, -(2**62) - 2**61])
@pytest.mark.parametrize("told_ns", [None, 2**62, -(2**62)])
def test_any_clock_reading_can_be_reported(offset_ns: int, told_ns: int | None) -> None:
    onward = told_ns if told_ns is None else UpstreamMap((9,), 0, told_ns, 0.01, 1e18, 1e18, 1.0, 1.0, 1e18)
    machine = FollowerAmongLiars()
    machine.start(-(2**60), 1)
    machine.turn()
    machine.hear(encode(welcome(2, 3, onward)), machine.member.leader)
    machine.lie_for_long(offset_ns, 420)
    assert machine.member.time.timekeeper.clock.samples > 100


@pytest.mark.parametrize("number", [-1, 2**32])
def test_a_number_that_no_request_can_carry_is_not_taken(number: int) -> None:
    member = TreeMember("me", INSTANCE, PARENTS, random.Random(1))
    member.receive_datagram(encode(welcome(2, number)), member.leader, 0)
    assert member.time.number is None


@pytest.mark.parametrize("offset_ns", [2**62 - 41, CENTURY_NS, -CENTURY_NS])
@pytest.mark.parametrize("turns", [280, 300])
def test_a_client_of_a_relay_recovers_from_a_clock_a_century_off(offset_ns: int, turns: int) -> None:
    machine = RelayAmongLiars()
    machine.start(0, 0)
    machine.lie_for_long(offset_ns, turns)
    machine.teardown()


def test_a_client_of_a_relay_recovers_from_a_bound_that_no_report_can_carry() -> None:
    machine = RelayAmongLiars()
    machine.start(0, 0)
    machine.turn()
    above = UpstreamMap((9,), 0, OFFSET_NS, 0.0, 1e18 - 1e9, 1e18 - 1e9, 1.0, 1.0)
    machine.hear(encode(welcome(2, 3, above)), machine.member.leader)
    machine.lie_for_long(OFFSET_NS, 290)
    machine.teardown()


@given(
    offset_ns=i64,
    skew=st.floats(-0.01, 0.01),
    error_ns=st.floats(0.0, allow_nan=False),
    now_ns=i64,
    growth=slopes,
)
def test_every_report_can_be_read(
    offset_ns: int, skew: float, error_ns: float, now_ns: int, growth: float
) -> None:
    timekeeper = Timekeeper(0)
    timekeeper.time_map = TimeMap(0, offset_ns, skew, error_ns, error_ns, growth, growth, 1, 0)
    message = Heartbeat(1, timekeeper.report(NodeState.READY, "", now_ns))
    assert decode(encode(message)) == message


def test_a_follower_recovers() -> None:
    run_state_machine_as_test(FollowerAmongLiars, settings=FEW)


def test_a_relay_and_its_client_recover() -> None:
    run_state_machine_as_test(RelayAmongLiars, settings=FEW)
