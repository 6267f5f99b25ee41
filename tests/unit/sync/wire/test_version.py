"""Members of a rig that run different versions say so to each other, in few bytes and without end."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture_app.protocol.event_text import leader_line
from capture_app.sync.rig.events import LeaderNotice, NodeChanged
from capture_app.sync.rig.leader_engine import Leader, LeaderConfig
from capture_app.sync.rig.time_client import TimeClient
from capture_app.sync.timekeeping.timekeeper import Timekeeper
from capture_app.sync.tree.member import TreeMember
from capture_app.sync.tree.relay_engine import Relay
from capture_app.sync.wire.codec import (
    TOKEN_BYTES,
    VERSION,
    WireError,
    answered_version,
    decode,
    encode,
    version_answer,
    version_mismatch,
    version_question,
)
from capture_app.sync.wire.datagrams import Goodbye

TOKEN = bytes(range(TOKEN_BYTES))
NODE, PARENT = ("10.0.0.2", 5), ("10.0.0.1", 47010)


def of_version(version: int, data: bytes) -> bytes:
    return data[:2] + bytes([version]) + data[3:]


def a_leader() -> Leader:
    return Leader(LeaderConfig(1, transfer_port=1), random.Random(1))


def a_client() -> TimeClient:
    return TimeClient("cam", 7, Timekeeper(1))


def answers(leader: Leader | Relay, data: bytes) -> list[bytes]:
    leader.receive_datagram(data, NODE, 0)
    return [sent for sent, to in leader.datagrams_to_send(0) if to == NODE]


def hellos(client: TimeClient) -> list[bytes]:
    client.handle_timer(0)
    return client.datagrams_to_send(0)


def test_a_leader_tells_its_version_to_whoever_asks() -> None:
    (answer,) = answers(a_leader(), version_question(TOKEN))
    assert answered_version(answer, TOKEN) == VERSION
    assert answered_version(answer, TOKEN[::-1]) is None
    assert answered_version(version_question(TOKEN), TOKEN) is None


def test_a_relay_tells_its_version_too() -> None:
    rng = random.Random(1)
    relay = Relay(TreeMember("gate", 3, (PARENT,), rng), LeaderConfig(3, transfer_port=1), rng)
    (answer,) = answers(relay, version_question(TOKEN))
    assert answered_version(answer, TOKEN) == VERSION


def test_a_client_of_an_older_version_says_what_to_do() -> None:
    client, version = a_client(), VERSION + 1
    (hello,) = hellos(client)
    told = of_version(version, version_answer(of_version(version + 1, hello)) or b"")
    client.receive_datagram(told, 1)
    assert client.report(1).message == version_mismatch(version)
    assert client.next_event() == LeaderNotice("refused", version_mismatch(version))
    client.receive_datagram(told, 2)
    assert client.next_event() is None


def test_a_node_that_sends_single_images_is_refused_by_a_leader_that_takes_batches() -> None:
    """Version 7 sent each image in a message of its own; its hello gets an answer that names version 8."""
    leader, version = a_leader(), 7
    (hello,) = hellos(a_client())
    (answer,) = answers(leader, of_version(version, hello))
    assert answer[:4] == version_answer(version_question(TOKEN))[:4]
    assert VERSION == 8
    assert not leader.roster.members
    assert version_mismatch(version) == (
        "its leader speaks version 7 of the protocol, and this node version 8:"
        " install the newer simulshot on the leader's machine too"
    )


def test_a_leader_says_that_a_node_speaks_another_version_and_not_all_the_time() -> None:
    leader = a_leader()
    leader.receive_datagram(version_question(TOKEN), ("10.0.0.6", 5), 0)
    assert leader.next_event() is None, "monitors and other leaders ask, too"
    (hello,) = hellos(a_client())
    for host in range(7, 10):
        leader.receive_datagram(of_version(7, hello), (f"10.0.0.{host}", 5), host)
    event = leader.next_event()
    assert isinstance(event, NodeChanged)
    assert leader_line(event) == (
        "refused a node at 10.0.0.7: it speaks version 7 of the protocol, and this leader version 8:"
        " install the newer simulshot on its machine too",
        True,
    )
    assert leader.next_event() is None
    leader.receive_datagram(of_version(9, hello), ("10.0.0.8", 5), 6_000_000_000)
    event = leader.next_event()
    assert isinstance(event, NodeChanged)
    assert event.reason.endswith("install the newer simulshot here too")


def test_the_older_end_is_the_one_to_renew() -> None:
    assert "on the leader's machine" in version_mismatch(VERSION - 1)
    assert "here" in version_mismatch(VERSION + 1)


def test_a_member_of_a_relay_hears_of_another_version_too() -> None:
    rng = random.Random(1)
    relay = Relay(TreeMember("gate", 3, (PARENT,), rng), LeaderConfig(3, transfer_port=1), rng)
    relay.handle_timer(0)
    relay.receive_datagram(of_version(VERSION + 1, version_answer(version_question(TOKEN)) or b""), PARENT, 1)
    event = relay.next_event()
    assert event == LeaderNotice("refused", version_mismatch(VERSION + 1))


@given(st.binary(max_size=40), st.integers(0, 255), st.integers(0, 255))
def test_no_answer_is_longer_or_is_answered(rest: bytes, version: int, kind: int) -> None:
    data = b"sS" + bytes([version, kind]) + rest
    answer = version_answer(data)
    if answer is not None:
        assert len(answer) <= len(data)
        assert version_answer(answer) is None
        # Nor by an end of any other version.
        for other in (VERSION + 1, 0xFF):
            assert version_answer(of_version(other, answer)) is None


def test_our_own_version_is_answered_as_ever() -> None:
    assert version_answer(encode(Goodbye(1)) + bytes(20)) is None
    with pytest.raises(WireError, match=f"protocol version 9, this is version {VERSION}") as found:
        decode(of_version(9, encode(Goodbye(1))))
    assert found.value.version == 9
