"""Engines with sealed datagrams, between a socket and a leader, a client or a relay; sans-IO.

A datagram that is not sealed, or not by the machine it names, never reaches the engine. Each datagram is
sealed just before it leaves, so that only its own seal delays it between its timestamp and the socket.
"""

from collections.abc import Iterable, Iterator
from contextlib import suppress

from capture_app.sync.rig.leader_engine import Leader
from capture_app.sync.sync_engine import Engine
from capture_app.sync.tree.relay_engine import Relay
from capture_app.sync.wire.codec import (
    WireError,
    decode,
    encode,
    is_version_answer,
    version_answer,
)
from capture_app.sync.wire.datagrams import Hello, JoinRefusal, Principal
from capture_app.trust.datagram_keys import Address, ClientKeys, LeaderKeys
from capture_app.trust.sealing import Refusals, Refused, SealError, unknown_key, unknown_key_of

Sealed = Iterator[tuple[bytes, Address]]
NOT_PAIRED = "this rig accepts paired nodes only: start this one without --open"
MAX_NOTICES = 64


class SealedClient:
    """Client with a key for each of its leaders; `leader_keys.missing` lists the leaders without one."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self.leader_keys = LeaderKeys()
        self.refusals = Refusals()
        self.next_timer = engine.next_timer
        self.handle_timer = engine.handle_timer

    def receive_datagram(self, data: bytes, address: Address, now_ns: int) -> None:
        """Process a datagram if a leader has sealed it."""
        if (message := _opened_by_client(data, address, self.leader_keys, self.refusals)) is not None:
            self._engine.receive_datagram(message, address, now_ns)

    def datagrams_to_send(self, now_ns: int) -> Sealed:
        """Yield the datagrams due, stamped with `now_ns`; the last one to a leader waits for its key."""
        yield from _sealed(self._engine.datagrams_to_send(now_ns), self.leader_keys)
        yield from self.leader_keys.take_stored()


class SealedLeader:
    """Leader with a key for each of its clients; answers to unknown peers never exceed their datagrams."""

    def __init__(self, engine: Leader | Relay) -> None:
        self._engine = engine
        self._leader = engine.leader if isinstance(engine, Relay) else engine
        self.keys = ClientKeys()
        self.refusals = Refusals()
        self._notices: list[tuple[bytes, Address]] = []
        self.next_timer = engine.next_timer
        self.handle_timer = engine.handle_timer

    def receive_datagram(self, data: bytes, address: Address, now_ns: int) -> None:
        """Process a datagram if a client has sealed it in its own name."""
        if (opened := self._open(data, address)) is None:
            if version_answer(data) is not None:
                self._leader.note_version(data, address, now_ns)
            return
        before = self._leader.impostures
        self._engine.receive_datagram(opened[0], address, now_ns, opened[1])
        if self._leader.impostures != before:
            self.refusals.add(address[0], Refused.NOT_ITS_OWN)

    def datagrams_to_send(self, now_ns: int) -> Sealed:
        """Yield the datagrams due, stamped with `now_ns`."""
        yield from _sealed(self._leader.datagrams_to_send(now_ns), self.keys)
        notices, self._notices = self._notices, []
        yield from notices

    def set_direct_pins(self, own: str, pins: Iterable[str]) -> None:
        """Set the pins for which no relay may speak: this machine's own, and of cameras paired here."""
        self._leader.roster.own_pin, self._leader.roster.direct_pins = own, frozenset(pins)

    def _open(self, data: bytes, address: Address) -> tuple[bytes, Principal | None] | None:
        try:
            return self.keys.open(data, address)
        except SealError as error:
            if version_answer(data) is None:
                self.refusals.add(address[0], error.why)
            answer = _answer_to_unknown(data, error.why)
            if answer is not None and len(answer) <= len(data) and len(self._notices) < MAX_NOTICES:
                self._notices.append((answer, address))
            return None


class SealedRelay(SealedLeader):
    """Relay with sealed datagrams: a leader to its clients, a client to its parents."""

    def __init__(self, engine: Relay) -> None:
        super().__init__(engine)
        self._relay = engine
        self.leader_keys = LeaderKeys()

    def datagrams_to_send(self, now_ns: int) -> Sealed:
        """Yield the datagrams due, stamped with `now_ns`."""
        yield from super().datagrams_to_send(now_ns)
        yield from _sealed(self._relay.datagrams_to_parents(now_ns), self.leader_keys)
        yield from self.leader_keys.take_stored()

    def _open(self, data: bytes, address: Address) -> tuple[bytes, Principal | None] | None:
        if not self.leader_keys.is_key_of(data, address):
            return super()._open(data, address)
        message = _opened_by_client(data, address, self.leader_keys, self.refusals)
        return None if message is None else (message, None)


def _answer_to_unknown(data: bytes, why: Refused) -> bytes | None:
    if why is not Refused.UNSEALED:
        return unknown_key(data) if why is Refused.UNKNOWN_KEY else None
    with suppress(WireError):
        if (version := version_answer(data)) is not None:
            return version
        if isinstance(message := decode(data), Hello):
            return encode(JoinRefusal(message.instance, NOT_PAIRED))
    return None


def _opened_by_client(data: bytes, leader: Address, keys: LeaderKeys, refusals: Refusals) -> bytes | None:
    if is_version_answer(data):
        # It has no seal so that every version can read it; it is only displayed.
        return data
    if (key_id := unknown_key_of(data)) is not None and keys.take_notice(leader, data, key_id):
        return None
    try:
        return keys.open(data, leader)
    except SealError as error:
        refusals.add(leader[0], error.why)
        return None


def _sealed(datagrams: Iterable[tuple[bytes, Address]], keys: ClientKeys | LeaderKeys) -> Sealed:
    for message, address in datagrams:
        if (data := keys.seal(message, address)) is not None:
            yield data, address
