"""The keys that a leader gives out."""

import random

from capture_app.sync.wire.datagrams import Principal
from capture_app.trust.datagram_keys import MAX_KEYS_PER_MACHINE, ClientKeys, LeaderKeys


def test_a_machine_takes_no_room_of_others_by_asking_for_keys() -> None:
    keys = ClientKeys(random.Random(1))
    node, leader = ("192.0.2.7", 5), ("192.0.2.1", 1)
    own = LeaderKeys()
    own.hold(leader, keys.grant(Principal("left", 1, pin="honest")))
    for run in range(2 * MAX_KEYS_PER_MACHINE):
        keys.grant(Principal("greedy", run, pin="greedy"))
    assert len(keys) == MAX_KEYS_PER_MACHINE + 1
    sealed = own.seal(b"hello", leader)
    assert sealed is not None
    assert keys.open(sealed, node)[0] == b"hello"
    keys.revoke_all_but(["honest"])
    assert len(keys) == 1
    keys.revoke_all_but([])
    assert len(keys) == 0
    keys.grant(Principal("left", 2, pin="honest"))
    assert len(keys) == 1
