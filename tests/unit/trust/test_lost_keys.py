"""Keys of a sealed rig that are lost, taken away and asked for again."""

from capture_app.sync.wire.codec import VERSION, answered_version, version_question
from capture_app.trust.datagram_keys import Address
from capture_app.trust.sealing import unknown_key
from tests.unit.trust.sealed_pair import LEADER, SealedRig, running

UNKNOWN_PEER: Address = ("stranger", 3)


def test_a_leader_that_does_not_know_the_key_is_asked_for_another_and_taken_back() -> None:
    rig = running("a")
    node = rig.nodes["a"]
    rig.leader.keys.revoke_all_but([])
    rig.run(600)
    assert node.sealed.leader_keys.missing == {LEADER}
    node.sealed.leader_keys.hold(LEADER, rig.leader.keys.grant(node.principal))
    assert not node.sealed.leader_keys.missing
    rig.run(600)
    assert rig.joined == ["a"]
    assert node.client.is_member


def test_what_a_leader_could_not_open_is_sent_again_with_the_new_key() -> None:
    """A leader that is started again has no keys: nobody shall wait for his next turn to ask to join."""
    rig = running("a")
    keys, leader_keys = rig.nodes["a"].sealed.leader_keys, rig.leader.keys
    leader_keys.revoke_all_but([])
    data = keys.seal(b"hello", LEADER)
    assert data is not None
    rig.deliver(unknown_key(data), LEADER, rig.nodes["a"].address)
    assert keys.take_stored() == []
    keys.hold(LEADER, leader_keys.grant(rig.nodes["a"].principal))
    ((again, to),) = keys.take_stored()
    assert to == LEADER
    assert leader_keys.open(again, rig.nodes["a"].address)[0] == b"hello"
    assert keys.take_stored() == []


def test_the_keys_of_a_removed_machine_go_and_the_others_stay() -> None:
    rig = running("a", "b")
    one, other = rig.nodes.values()
    keys = rig.leader.keys
    keys.revoke_all_but({one.principal.pin, other.principal.pin})
    rig.run(300)
    assert rig.joined == ["a", "b"]
    keys.revoke_all_but({one.principal.pin})
    rig.run(3000)
    assert rig.joined == ["a"]
    assert not one.sealed.leader_keys.missing
    assert other.sealed.leader_keys.missing == {LEADER}


def test_a_notice_that_nobody_could_have_written_is_no_reason_to_ask_for_a_key() -> None:
    rig = running("a")
    node = rig.nodes["a"]
    data = node.sealed.leader_keys.seal(b"", LEADER)
    assert data is not None
    far = data[:8] + (2**40).to_bytes(8, "big") + data[16:]
    rig.deliver(unknown_key(far), LEADER, node.address)
    assert not node.sealed.leader_keys.missing
    rig.deliver(unknown_key(data), LEADER, node.address)
    assert node.sealed.leader_keys.missing == {LEADER}


def test_a_notice_about_an_earlier_key_is_no_reason_to_ask_for_another() -> None:
    """A leader's late notices would make a node ask again and again."""
    rig = running("a")
    node, keys = rig.nodes["a"], rig.nodes["a"].sealed.leader_keys
    data = keys.seal(b"", LEADER)
    assert data is not None
    keys.hold(LEADER, rig.leader.keys.grant(node.principal))
    assert keys.seal(b"", LEADER) is not None
    first = data[:8] + (1).to_bytes(8, "big") + data[16:]
    rig.deliver(unknown_key(first), LEADER, node.address)
    assert not keys.missing


def test_a_node_without_a_key_still_tells_and_hears_of_another_version() -> None:
    rig = SealedRig("a")
    question = version_question(b"12345678")
    rig.deliver(question, UNKNOWN_PEER, LEADER)
    ((answer, to),) = rig.leader.datagrams_to_send(rig.now_ns)
    assert to == UNKNOWN_PEER
    assert answered_version(answer, b"12345678") == VERSION
    newer = answer[:2] + bytes([VERSION + 1]) + answer[3:]
    rig.deliver(newer, LEADER, rig.nodes["a"].address)
    assert f"version {VERSION + 1}" in rig.nodes["a"].client.why_joining
