"""What leaders and nodes owe each other of keys, in histories that are drawn, without a socket.

What is sealed with a key that its leader still has is opened once, as its sender's; each answer goes to the
node that was heard last at an address, and is opened by no other. A node asks for a key exactly where it has
none, or where its leader says that the present one is unknown, and then sends its last message again.
"""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture_app.sync.wire.datagrams import Principal
from capture_app.trust import datagram_keys
from capture_app.trust.datagram_keys import Address, ClientKeys, LeaderKeys
from capture_app.trust.sealing import Refused, SealError, unknown_key

LEADERS: tuple[Address, ...] = (("leader", 1), ("leader", 2))
PLACES: tuple[Address, ...] = (("a", 7), ("b", 7), ("b", 8))
PRINCIPALS = tuple(
    Principal(name, number, pin)
    for number, (name, pin) in enumerate([("a", "one"), ("b", "one"), ("c", "two"), ("d", "two")])
)
"""Two nodes of each of two machines."""
MAX_KEYS, MAX_KEYS_PER_MACHINE = 3, 2


class KeyDuty:
    """Two leaders, and nodes that may be known to both; each method is something that happens."""

    def __init__(self) -> None:
        self.leaders = [ClientKeys() for _ in LEADERS]
        self.nodes = [LeaderKeys() for _ in PRINCIPALS]
        self.valid: list[dict[int, int]] = [{} for _ in LEADERS]
        """Node of each key that a leader has, by number, the one heard last at the end."""
        self.at: list[dict[Address, int]] = [{} for _ in LEADERS]
        """Key that was heard last at an address."""
        self.present: dict[tuple[int, int], int] = {}
        """Key that a node uses with a leader."""
        self.last: dict[tuple[int, int], bytes] = {}
        self.again: dict[tuple[int, int], bytes] = {}
        """What a node sends again, as its key has come."""
        self.missing: set[tuple[int, int]] = set()
        self.sent = 0

    def grant(self, node: int, leader: int, _: int) -> None:
        """A leader issues a node a key."""
        key_id, key = self.leaders[leader].grant(PRINCIPALS[node])
        valid = self.valid[leader]
        assert key_id not in valid
        valid[key_id] = node
        own = [number for number, of in valid.items() if PRINCIPALS[of].pin == PRINCIPALS[node].pin]
        if len(own) > MAX_KEYS_PER_MACHINE:
            self._forget(leader, own[0])
        if len(valid) > MAX_KEYS:
            self._forget(leader, next(iter(valid)))
        self.nodes[node].hold(LEADERS[leader], (key_id, key))
        self.present[node, leader] = key_id
        self.missing.discard((node, leader))
        if (node, leader) in self.last:
            self.again[node, leader] = self.last[node, leader]

    def send(self, node: int, leader: int, place: int) -> None:
        """A node sends a message to a leader, from where it is now."""
        self.sent += 1
        message = b"%d" % self.sent
        self.last[node, leader] = message
        data = self.nodes[node].seal(message, LEADERS[leader])
        if (node, leader) not in self.present:
            self.missing.add((node, leader))
            assert data is None
            return
        assert data is not None
        self._arrive(node, leader, place, data, message)

    def send_again(self, node: int, _: int, place: int) -> None:
        """A node sends what waited for its keys."""
        due = {LEADERS[leader]: self.again.pop((node, leader)) for of, leader in [*self.again] if of == node}
        again = self.nodes[node].take_stored()
        assert [to for _, to in again] == [*due]
        for data, to in again:
            self._arrive(node, LEADERS.index(to), place, data, due[to])

    def _arrive(self, node: int, leader: int, place: int, data: bytes, message: bytes) -> None:
        key_id, valid, keys = self.present[node, leader], self.valid[leader], self.leaders[leader]
        if key_id not in valid:
            assert why_refused(keys, data, PLACES[place]) is Refused.UNKNOWN_KEY
            self._notify(node, leader, unknown_key(data), key_id)
            return
        assert keys.open(data, PLACES[place]) == (message, PRINCIPALS[node])
        assert why_refused(keys, data, PLACES[place]) is Refused.REPLAYED
        valid[key_id] = valid.pop(key_id)
        at = self.at[leader]
        if at.get(PLACES[place]) != key_id:
            self.at[leader] = {where: of for where, of in at.items() if of != key_id}
            self.at[leader][PLACES[place]] = key_id

    def _notify(self, node: int, leader: int, notice: bytes, key_id: int) -> None:
        """A leader says that it does not know a node's key; no other node asks for one for that."""
        never_sent = notice[:8] + (2**40).to_bytes(8, "big")
        for number, keys in enumerate(self.nodes):
            is_meant = self.present.get((number, leader)) == key_id
            assert not keys.take_notice(LEADERS[leader], never_sent, key_id)
            assert keys.is_key_of(notice, LEADERS[leader]) is is_meant
            assert keys.take_notice(LEADERS[leader], notice, key_id) is is_meant
            assert not keys.take_notice(LEADERS[1 - leader], notice, key_id)
        self.missing.add((node, leader))

    def answer(self, _: int, leader: int, place: int) -> None:
        """A leader sends something to an address."""
        key_id = self.at[leader].get(PLACES[place])
        data = self.leaders[leader].seal(b"answer", PLACES[place])
        assert (data is None) is (key_id is None)
        if data is None:
            return
        for number, keys in enumerate(self.nodes):
            assert keys.is_key_of(b"plain" + data, LEADERS[leader]) is False
            is_meant = self.present.get((number, leader)) == key_id
            assert keys.is_key_of(data, LEADERS[leader]) is is_meant
            if is_meant:
                assert keys.open(data, LEADERS[leader]) == b"answer"
            else:
                assert why_refused(keys, data, LEADERS[leader]) is Refused.UNKNOWN_KEY

    def revoke(self, node: int, leader: int, _: int) -> None:
        """A machine is removed: only the other one stays known."""
        stays = {principal.pin for principal in PRINCIPALS} - {PRINCIPALS[node].pin}
        self.leaders[leader].revoke_all_but(stays)
        for key_id, of in [*self.valid[leader].items()]:
            if PRINCIPALS[of].pin not in stays:
                self._forget(leader, key_id)

    def _forget(self, leader: int, key_id: int) -> None:
        del self.valid[leader][key_id]
        self.at[leader] = {where: of for where, of in self.at[leader].items() if of != key_id}

    def check(self) -> None:
        """See that each node asks for the keys that it lacks."""
        for number, keys in enumerate(self.nodes):
            assert keys.missing == {LEADERS[leader] for node, leader in self.missing if node == number}


def why_refused(keys: ClientKeys | LeaderKeys, data: bytes, sender: Address) -> Refused:
    with pytest.raises(SealError) as refused:
        keys.open(data, sender)
    return refused.value.why


KINDS = ("grant", "grant", "send", "send", "send", "answer", "send_again", "revoke")


@settings(max_examples=30)
@given(st.integers(0, 2**32))
def test_keys_are_used_asked_for_and_forgotten_as_leaders_and_nodes_owe_each_other(seed: int) -> None:
    chance, duty = random.Random(seed), KeyDuty()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(datagram_keys, "MAX_KEYS", MAX_KEYS)
        patch.setattr(datagram_keys, "MAX_KEYS_PER_MACHINE", MAX_KEYS_PER_MACHINE)
        for kind in chance.choices(KINDS, k=60):
            step = getattr(duty, kind)
            step(chance.randrange(len(PRINCIPALS)), chance.randrange(len(LEADERS)), chance.randrange(3))
            duty.check()


def test_no_two_keys_have_one_number(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = iter((7, 7, 8))
    monkeypatch.setattr("secrets.randbits", lambda _: next(drawn))
    keys = ClientKeys()
    assert [keys.grant(principal)[0] for principal in PRINCIPALS[:2]] == [7, 8]
