"""Keys of a sealed rig that are lost, taken away and asked for again."""

from capture_app.sync.wire.codec import VERSION, answered_version, version_question
from capture_app.trust.datagram_keys import Address
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
