"""What a seal lets through to an engine and from it: of a client, a leader and a relay that take notes."""

from types import SimpleNamespace
from typing import Any

from capture_app.sync.tree.relay_engine import Relay
from capture_app.sync.wire.codec import VERSION, encode, version_question
from capture_app.sync.wire.datagrams import Goodbye, Principal
from capture_app.trust.datagram_keys import Address, ClientKeys
from capture_app.trust.sealed_engines import MAX_NOTICES, SealedClient, SealedLeader, SealedRelay
from capture_app.trust.sealing import Refused, unknown_key

PARENT, CHILD, UNKNOWN_PEER = ("parent", 1), ("child", 2), ("stranger", 3)
LEFT = Principal("left", 1, pin="pin")


class Notes:
    """An engine that notes what it receives, and sends what is put in."""

    def __init__(self) -> None:
        self.received: list[tuple[Any, ...]] = []
        self.outbox: list[tuple[bytes, Address]] = []
        self.versions: list[Address] = []
        self.impostures, self.is_imposture = 0, False
        self.roster = SimpleNamespace(own_pin="", direct_pins=frozenset())

    def receive_datagram(self, data: bytes, address: Address, now_ns: int, *principal: Any) -> None:
        self.received.append((data, address, now_ns, *principal))
        self.impostures += self.is_imposture

    def datagrams_to_send(self, now_ns: int) -> list[tuple[bytes, Address]]:
        sent, self.outbox = self.outbox, []
        return sent

    def note_version(self, data: bytes, address: Address, now_ns: int) -> None:
        self.versions.append(address)

    def next_timer(self) -> int:
        return 7

    def handle_timer(self, now_ns: int) -> None:
        self.received.append((now_ns,))


class Between(Notes, Relay):
    """A relay of that kind, which is a leader to its clients."""

    def __init__(self) -> None:
        Notes.__init__(self)
        self.leader: Any = Notes()
        self.upwards: list[tuple[bytes, Address]] = []

    def datagrams_to_parents(self, now_ns: int) -> list[tuple[bytes, Address]]:
        sent, self.upwards = self.upwards, []
        return sent


def test_a_clients_last_message_waits_for_its_key_and_only_its_leader_is_heard() -> None:
    engine: Any = Notes()
    client, keys = SealedClient(engine), ClientKeys()
    assert client.next_timer() == 7
    engine.outbox = [(b"first", PARENT), (b"last", PARENT)]
    assert list(client.datagrams_to_send(0)) == []
    client.leader_keys.hold(PARENT, keys.grant(LEFT))
    ((sealed, to),) = client.datagrams_to_send(0)
    assert (keys.open(sealed, CHILD), to) == ((b"last", LEFT), PARENT)
    answer = keys.seal(b"answer", CHILD)
    assert answer is not None
    for data, sender in ((answer, UNKNOWN_PEER), (b"plain", PARENT), (answer, PARENT), (answer, PARENT)):
        client.receive_datagram(data, sender, 9)
    assert engine.received == [(b"answer", PARENT, 9)]
    client.receive_datagram(unknown_key(sealed), PARENT, 9)
    assert client.refusals.counts == {
        ("stranger", Refused.UNKNOWN_KEY): 1,
        ("parent", Refused.UNSEALED): 1,
        ("parent", Refused.REPLAYED): 1,
    }
    assert client.leader_keys.missing == {PARENT}


def test_a_leader_hears_each_client_under_its_own_name_and_counts_all_others() -> None:
    engine: Any = Notes()
    leader = SealedLeader(engine)
    client = SealedClient(Notes())
    client.leader_keys.hold(PARENT, leader.keys.grant(LEFT))
    engine.outbox = [(b"to nobody", UNKNOWN_PEER)]
    for is_imposture in (False, True):
        engine.is_imposture = is_imposture
        data = client.leader_keys.seal(b"hello", PARENT)
        assert data is not None
        leader.receive_datagram(data, CHILD, 9)
    leader.receive_datagram(version_question(b"12345678"), UNKNOWN_PEER, 9)
    leader.receive_datagram(encode(Goodbye(1)), UNKNOWN_PEER, 9)
    assert engine.received == [(b"hello", CHILD, 9, LEFT)] * 2
    assert engine.versions == [UNKNOWN_PEER]
    assert leader.refusals.counts == {("child", Refused.NOT_ITS_OWN): 1, ("stranger", Refused.UNSEALED): 1}
    engine.outbox.append((b"answer", CHILD))
    ((sealed, to), (answer, asker)) = leader.datagrams_to_send(9)
    assert (client.leader_keys.open(sealed, PARENT), to) == (b"answer", CHILD)
    assert (answer[2], asker) == (VERSION, UNKNOWN_PEER)
    leader.set_direct_pins("own", ["b", "a"])
    assert (engine.roster.own_pin, engine.roster.direct_pins) == ("own", {"a", "b"})


def test_a_leader_answers_so_many_strangers_at_a_time_and_then_others() -> None:
    engine: Any = Notes()
    leader = SealedLeader(engine)
    for round_ in range(2):
        for number in range(MAX_NOTICES + 9):
            leader.receive_datagram(version_question(b"12345678"), ("stranger", number), round_)
        assert [port for _, (_, port) in leader.datagrams_to_send(0)] == [*range(MAX_NOTICES)]


def test_a_relay_tells_its_parents_datagrams_from_its_clients() -> None:
    engine, above = Between(), ClientKeys()
    relay, child = SealedRelay(engine), SealedClient(Notes())
    relay.leader_keys.hold(PARENT, above.grant(LEFT))
    child.leader_keys.hold(PARENT, relay.keys.grant(LEFT))
    up = relay.leader_keys.seal(b"up", PARENT)
    assert up is not None
    above.open(up, CHILD)
    from_parent, from_child = above.seal(b"from above", CHILD), child.leader_keys.seal(b"from below", PARENT)
    assert from_parent is not None
    assert from_child is not None
    for _ in range(2):
        relay.receive_datagram(from_parent, PARENT, 9)
        relay.receive_datagram(from_child, CHILD, 9)
    assert engine.received == [(b"from above", PARENT, 9, None), (b"from below", CHILD, 9, LEFT)]
    assert relay.refusals.counts == {("parent", Refused.REPLAYED): 1, ("child", Refused.REPLAYED): 1}
    relay.receive_datagram(unknown_key(up), PARENT, 9)
    assert relay.leader_keys.missing == {PARENT}
    relay.leader_keys.hold(PARENT, above.grant(LEFT))
    engine.leader.outbox, engine.upwards = [(b"down", CHILD)], [(b"news", PARENT)]
    (down, news, again) = relay.datagrams_to_send(9)
    assert child.leader_keys.open(down[0], PARENT) == b"down"
    assert [above.open(data, CHILD)[0] for data, _ in (news, again)] == [b"news", b"up"]
