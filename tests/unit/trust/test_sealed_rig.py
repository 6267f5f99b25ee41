"""A sealed rig: what strangers, other nodes or whoever is on the path send changes nothing in it."""

import dataclasses
import typing
from collections.abc import Iterator

import pytest
from msgspec import structs

from capture_app.common.node_state import NodeState
from capture_app.sync.rig.burst_orders import BurstOrder
from capture_app.sync.rig.events import ForeignTrigger, NodeChanged, TriggerAnswered
from capture_app.sync.wire.codec import VERSION, FromClient, Message, decode, encode
from capture_app.sync.wire.datagrams import (
    Goodbye,
    Heartbeat,
    HeartbeatAck,
    Hello,
    JoinRefusal,
    MemberReports,
    Notice,
    Principal,
    Report,
    RigConfigMessage,
    TimeReply,
    TimeRequest,
    Trigger,
    TriggerAck,
    UnknownMember,
    Welcome,
)
from capture_app.trust.datagram_keys import Address
from capture_app.trust.sealing import HEAD_BYTES, MAX_KINDS, SEAL_BYTES, Refusals, Refused
from tests.facts import make_facts
from tests.unit.trust.sealed_pair import LEADER, SealedRig, running

CONFIG = RigConfigMessage(leader=9, anchor_leader_ns=0, period_ns=60_000_000, poll_interval_ns=60_000_000_000)
UNKNOWN_PEER: Address = ("stranger", 3)
Datagram = tuple[bytes, Address, Address]


def every_message(number: int, instance: int, name: str) -> list[Message]:
    """One of each kind of the protocol, as somebody makes it up who knows all numbers."""
    messages: list[Message] = [
        TimeRequest(number, 1, 2),
        TimeReply(number, 1, 2, 3, 4),
        Hello(name, instance, make_facts(period_ns=50_000_000)),
        Hello(name, instance, make_facts(), via="relay"),
        Welcome(instance, number, 1, CONFIG),
        JoinRefusal(instance, "no"),
        Heartbeat(number, Report(state=NodeState.FAILED)),
        MemberReports(((number, Report(state=NodeState.LOST, message="gone")),)),
        HeartbeatAck(number, CONFIG),
        UnknownMember(number),
        Trigger(number, 5, 1, 0, 33_333_333, 3),
        TriggerAck(number, 5, 1, "no"),
        Notice(number, "no"),
        Goodbye(number),
    ]
    assert {type(message) for message in messages} == set(typing.get_args(Message))
    return messages


def state(rig: SealedRig) -> object:
    """All that messages can change at both ends, as it is at this moment."""
    leader = [
        [dataclasses.replace(member) for member in rig.engine.roster.by_name()],
        rig.engine.grid,
        rig.engine.poll_interval_ns,
        rig.engine.next_timer(),
    ]
    for node in rig.nodes.values():
        client, keeper = node.client, node.client.timekeeper
        leader += [client.report(rig.now_ns), client.next_timer(), client.has_burst_pending, client.number]
        leader += [client.followed, keeper.time_map, keeper.clock.samples, len(keeper.outstanding)]
    return leader


def numbers(rig: SealedRig, name: str) -> tuple[int, int, str]:
    client = rig.nodes[name].client
    assert client.number is not None
    return client.number, client.config.instance, name


def test_a_sealed_rig_joins_keeps_time_and_takes_bursts() -> None:
    rig = running("a", "b")
    burst = rig.engine.trigger(rig.now_ns, BurstOrder(frames=2))
    rig.run(300)
    events = [event for event in iter(rig.engine.next_event, None) if getattr(event, "burst", 0)]
    assert sorted(event.name for event in events) == ["a", "b"]
    assert burst.clients == ("a", "b")
    assert rig.leader.refusals.counts.total() == 0
    assert all(node.sealed.refusals.counts.total() == 0 for node in rig.nodes.values())


@pytest.mark.parametrize("sender", [UNKNOWN_PEER, ("a", 2)], ids=["stranger", "address of a node"])
def test_without_a_key_no_message_changes_the_leader(sender: Address) -> None:
    rig = running("a")
    before = state(rig)
    for message in every_message(*numbers(rig, "a")):
        plain = encode(message)
        rig.deliver(plain, sender, LEADER)
        assert state(rig) == before, message
        for answer, to in rig.leader.datagrams_to_send(rig.now_ns):
            assert to == sender
            assert isinstance(decode(answer), JoinRefusal)
            assert len(answer) <= len(plain)
    assert rig.leader.refusals.counts.total() == len(every_message(1, 1, "a"))


@pytest.mark.parametrize("sender", [UNKNOWN_PEER, LEADER], ids=["stranger", "address of the leader"])
def test_without_a_key_no_message_changes_a_node(sender: Address) -> None:
    rig = running("a")
    before, node = state(rig), rig.nodes["a"]
    for message in every_message(*numbers(rig, "a")):
        rig.deliver(encode(message), sender, node.address)
        assert state(rig) == before, message


def test_a_hello_of_a_stranger_leaves_nothing_behind_and_is_answered_by_less() -> None:
    rig = SealedRig()
    before = state(rig)
    hello = encode(Hello("x", 1, make_facts()))
    for _ in range(1000):
        rig.deliver(hello, UNKNOWN_PEER, LEADER)
    assert state(rig) == before
    answers = [data for data, _ in rig.leader.datagrams_to_send(rig.now_ns)]
    assert 0 < len(answers) < 1000
    assert all(len(data) <= len(hello) for data in answers)


def test_a_camera_with_a_key_speaks_for_no_other() -> None:
    rig = running("a", "b")
    hostile, before = rig.nodes["b"], state(rig)
    for message in every_message(*numbers(rig, "a")):
        data = hostile.sealed.leader_keys.seal(encode(message), LEADER)
        assert data is not None
        for sender in (hostile.address, rig.nodes["a"].address):
            rig.deliver(data, sender, LEADER)
        assert state(rig) == before, message
    assert rig.engine.impostures == sum(isinstance(m, FromClient) for m in every_message(1, 1, "a"))


def test_a_camera_with_a_key_cannot_use_it_against_another_node() -> None:
    rig = running("a", "b")
    hostile, before = rig.nodes["b"], state(rig)
    for message in every_message(*numbers(rig, "a")):
        data = hostile.sealed.leader_keys.seal(encode(message), LEADER)
        assert data is not None
        rig.deliver(data, LEADER, rig.nodes["a"].address)
        assert state(rig) == before, message


def test_another_machine_cannot_take_the_name_of_a_lost_camera() -> None:
    rig = running("a", "b")
    del rig.nodes["a"]
    rig.run(3000)
    assert rig.joined == ["b"]
    thief = rig.nodes["b"]
    principal = Principal("a", 777, pin="pin of b")
    thief.sealed.leader_keys.hold(LEADER, rig.leader.keys.grant(principal))
    data = thief.sealed.leader_keys.seal(encode(Hello("a", 777, make_facts())), LEADER)
    assert data is not None
    rig.deliver(data, thief.address, LEADER)
    rig.run(1)
    assert "a" not in rig.joined


def test_every_datagram_of_a_running_rig_counts_once() -> None:
    rig = SealedRig("a", "b")
    seen: list[Datagram] = []
    rig.tamper = lambda *datagram: seen.append(datagram) or [datagram]
    rig.run(800)
    rig.tamper = lambda *datagram: [datagram]
    before = state(rig)
    kinds = {type(decode(data[HEAD_BYTES:-SEAL_BYTES])) for data, _, _ in seen}
    assert kinds >= {TimeRequest, TimeReply, Hello, Welcome, Heartbeat, HeartbeatAck}
    for data, sender, to in seen:
        for replay_from in (sender, UNKNOWN_PEER):
            rig.deliver(data, replay_from, to)
    assert state(rig) == before
    assert rig.joined == ["a", "b"]


def altered(data: bytes) -> Iterator[bytes]:
    """The datagram with each field of its message replaced by a value that could be, and its own seal."""
    head, seal = data[:HEAD_BYTES], data[-SEAL_BYTES:]
    message = decode(data[HEAD_BYTES:-SEAL_BYTES])
    for changed in with_other_values(message):
        plain = encode(changed)
        assert plain != data[HEAD_BYTES:-SEAL_BYTES]
        yield head + plain + seal


def with_other_values(value: typing.Any) -> Iterator[typing.Any]:
    """The same structure with each value in it, however deep, replaced."""
    if hasattr(value, "__struct_fields__"):
        for name in value.__struct_fields__:
            for other in with_other_values(getattr(value, name)):
                yield structs.replace(value, **{name: other})
    elif isinstance(value, bool):
        yield not value
    elif isinstance(value, int):
        yield value + 3_600_000_000_000 if abs(value) > 2**33 else value ^ 1
    elif isinstance(value, float):
        yield 0.5 if value != 0.5 else 0.25
    elif isinstance(value, NodeState):
        yield NodeState.READY if value is not NodeState.READY else NodeState.FAILED
    elif isinstance(value, str):
        yield value + "x"


def test_altering_any_field_of_any_message_on_the_path_is_refused_and_counted() -> None:
    rig = SealedRig("a", "b")
    tried: dict[type, int] = {}

    def alter(data: bytes, sender: Address, to: Address) -> list[Datagram]:
        before, counted = state(rig), refused(rig)
        changed = list(altered(data))
        for forged in changed:
            rig.deliver(forged, sender, to)
        assert state(rig) == before
        assert refused(rig) == counted + len(changed)
        kind = type(decode(data[HEAD_BYTES:-SEAL_BYTES]))
        tried[kind] = tried.get(kind, 0) + len(changed)
        return [(data, sender, to)]

    rig.run(20)
    rig.tamper = alter
    rig.nodes["b"].client.change_leader("for a second hello", rig.now_ns)
    rig.run(600)
    rig.engine.trigger(rig.now_ns, BurstOrder(frames=2))
    rig.run(60)
    rig.nodes["b"].client.leave()
    rig.run(5)
    assert set(tried) >= {
        *(TimeRequest, TimeReply, Hello, Welcome, Heartbeat, HeartbeatAck, Trigger, TriggerAck, Goodbye),
    }
    assert min(tried.values()) > 0
    assert rig.joined == ["a"]


def refused(rig: SealedRig) -> int:
    return rig.leader.refusals.counts.total() + sum(
        node.sealed.refusals.counts.total() for node in rig.nodes.values()
    )


def test_refusals_are_told_by_host_and_reason_now_and_then() -> None:
    rig = running("a")
    for _ in range(1000):
        rig.deliver(encode(Goodbye(1)), UNKNOWN_PEER, LEADER)
    (news,) = rig.leader.refusals.take_events(rig.now_ns)
    assert str(news) == "refused 1000 datagrams from stranger: not sealed"
    rig.deliver(encode(Goodbye(1)), UNKNOWN_PEER, LEADER)
    assert rig.leader.refusals.take_events(rig.now_ns) == []
    (news,) = rig.leader.refusals.take_events(rig.now_ns + 10_000_000_000)
    assert (news.count, news.why) == (1, Refused.UNSEALED)


def test_the_log_names_a_node_of_another_version() -> None:
    """It said of it, if anything, that its datagrams were not sealed."""
    rig = running("a")
    while rig.engine.next_event() is not None:
        pass
    data = encode(Goodbye(1)) + bytes(40)
    for _ in range(20):
        rig.deliver(data[:2] + bytes([VERSION - 1]) + data[3:], UNKNOWN_PEER, LEADER)
    event = rig.engine.next_event()
    assert isinstance(event, NodeChanged)
    assert event.reason.startswith(f"it speaks version {VERSION - 1} of the protocol")
    assert rig.engine.next_event() is None
    assert not rig.leader.refusals.counts


def test_a_trigger_of_a_leader_that_does_not_exist_is_refused_and_told_once() -> None:
    rig = running("a")
    node, (number, _, _) = rig.nodes["a"], numbers(rig, "a")
    events = list(iter(node.client.next_event, None))
    for burst in range(10):
        node.client.receive_datagram(encode(Trigger(number, 6, burst, 0, 33_333_333, 3)), rig.now_ns)
    assert not node.client.has_burst_pending
    events = list(iter(node.client.next_event, None))
    assert events == [ForeignTrigger(6, 0)]


def test_an_answer_to_the_trigger_of_another_leader_counts_for_nothing() -> None:
    rig = running("a")
    rig.tamper = lambda *_: []
    rig.engine.trigger(rig.now_ns, BurstOrder(frames=1))
    number, _, _ = numbers(rig, "a")
    list(iter(rig.engine.next_event, None))
    node = rig.nodes["a"]
    rig.engine.receive_datagram(encode(TriggerAck(number, 6, 1)), node.address, rig.now_ns, node.principal)
    assert rig.engine.next_event() is None
    rig.engine.receive_datagram(encode(TriggerAck(number, 5, 1)), node.address, rig.now_ns, node.principal)
    assert rig.engine.next_event() == TriggerAnswered("a", 1)


def test_datagrams_that_come_twice_now_and_then_are_not_worth_a_word() -> None:
    refusals = Refusals()
    for _ in range(9):
        refusals.add("host", Refused.REPLAYED)
    assert refusals.take_events(0) == []
    refusals.add("host", Refused.REPLAYED)
    assert [str(news) for news in refusals.take_events(1)] == ["refused 10 datagrams from host: sent before"]


def test_hosts_beyond_so_many_are_counted_together_and_known_ones_as_before() -> None:
    refusals = Refusals()
    for number in range(MAX_KINDS + 5):
        refusals.add(f"host{number}", Refused.FORGED)
    refusals.add("host0", Refused.FORGED)
    assert len(refusals.counts) == MAX_KINDS + 1
    assert refusals.counts["host0", Refused.FORGED] == 2
    assert refusals.counts["other hosts", Refused.FORGED] == 5
