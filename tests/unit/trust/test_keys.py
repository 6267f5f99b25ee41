"""The keys that a leader gives out."""

import pytest

from capture_app.sync.wire.datagrams import Principal
from capture_app.trust.datagram_keys import MAX_KEYS_PER_MACHINE, ClientKeys, LeaderKeys
from capture_app.trust.sealing import SealError

NODE, LEADER = ("192.0.2.7", 5), ("192.0.2.1", 1)


def granted(keys: ClientKeys, pin: str, run: int = 1) -> LeaderKeys:
    own = LeaderKeys()
    own.hold(LEADER, keys.grant(Principal("left", run, pin=pin)))
    return own


def is_known(keys: ClientKeys, own: LeaderKeys) -> bool:
    sealed = own.seal(b"hello", LEADER)
    assert sealed is not None
    try:
        return keys.open(sealed, NODE)[0] == b"hello"
    except SealError:
        return False


def test_a_machine_takes_no_room_of_others_by_asking_for_keys() -> None:
    keys = ClientKeys()
    honest = granted(keys, "honest")
    greedy = [granted(keys, "greedy", run) for run in range(2 * MAX_KEYS_PER_MACHINE)]
    assert [is_known(keys, one) for one in greedy].count(True) == MAX_KEYS_PER_MACHINE
    assert not is_known(keys, greedy[0])
    assert is_known(keys, honest)


def test_keys_of_machines_that_are_no_longer_known_are_revoked() -> None:
    keys = ClientKeys()
    honest, *removed = granted(keys, "honest"), granted(keys, "removed", 1), granted(keys, "removed", 2)
    keys.revoke_all_but(["honest"])
    assert is_known(keys, honest)
    assert [is_known(keys, one) for one in removed] == [False, False]
    keys.revoke_all_but([])
    assert not is_known(keys, honest)
    assert is_known(keys, granted(keys, "honest", 2))


def test_beyond_the_limit_the_key_not_heard_for_longest_is_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("capture_app.trust.datagram_keys.MAX_KEYS", 2)
    keys = ClientKeys()
    first, second = granted(keys, "first"), granted(keys, "second")
    assert is_known(keys, first)
    third = granted(keys, "third")
    assert [is_known(keys, one) for one in (first, second, third)] == [True, False, True]
