"""A stranger may ask a sealed rig for its version, and one that speaks openly is told what to do."""

import random

from capture_app.sync.rig.leader_engine import Leader, LeaderConfig
from capture_app.sync.wire.codec import (
    TOKEN_BYTES,
    VERSION,
    answered_version,
    decode,
    encode,
    version_question,
)
from capture_app.sync.wire.datagrams import Hello, JoinRefusal
from capture_app.trust.sealed_engines import SealedLeader
from tests.facts import make_facts

UNKNOWN_PEER, TOKEN = ("10.0.0.9", 5), bytes(TOKEN_BYTES)


def sealed_leader() -> SealedLeader:
    return SealedLeader(Leader(LeaderConfig(1, transfer_port=1), random.Random(1)))


def answers(leader: SealedLeader, data: bytes) -> list[bytes]:
    leader.receive_datagram(data, UNKNOWN_PEER, 0)
    return [sent for sent, to in leader.datagrams_to_send(0) if to == UNKNOWN_PEER]


def test_asking_for_the_version_is_answered_and_is_no_attack() -> None:
    leader = sealed_leader()
    (answer,) = answers(leader, version_question(TOKEN))
    assert answered_version(answer, TOKEN) == VERSION
    assert leader.refusals.counts.total() == 0


def test_a_node_that_speaks_openly_is_told_what_to_do_in_no_more_bytes() -> None:
    leader = sealed_leader()
    hello = encode(Hello("cam", 7, make_facts()))
    (answer,) = answers(leader, hello)
    assert len(answer) <= len(hello)
    message = decode(answer)
    assert isinstance(message, JoinRefusal)
    assert "start this one without --open" in message.reason
    assert leader.refusals.counts.total() == 1
