"""Keys of a leader's clients: issued one by one over authenticated streams, each for one instance."""

import secrets
from collections.abc import Collection
from dataclasses import dataclass

from capture_app.sync.wire.datagrams import Principal
from capture_app.trust.sealing import KEY_BYTES, Refused, Seal, SealError, key_of, unknown_key_of

Address = tuple[str, int]

MAX_KEYS = 20_000
"""Maximum number of stored keys; beyond it, the least recently used key is forgotten."""
MAX_KEYS_PER_MACHINE = 256
"""Maximum number of keys per machine; beyond it, its own least recently used key is forgotten."""


Grant = tuple[int, bytes]
"""Number and key for one instance of a client."""


@dataclass(slots=True)
class _Client:
    principal: Principal
    seal: Seal
    address: Address | None = None
    """Source address of its newest datagram."""


class ClientKeys:
    """Keys that a leader has issued."""

    def __init__(self) -> None:
        self._clients: dict[int, _Client] = {}
        """Clients by key number, most recently heard last."""
        self._at: dict[Address, _Client] = {}

    def grant(self, principal: Principal) -> Grant:
        """Issue a key; earlier keys of the same instance remain valid until they are forgotten."""
        key_id, key = secrets.randbits(32), secrets.token_bytes(KEY_BYTES)
        while key_id in self._clients:
            key_id = secrets.randbits(32)
        self._clients[key_id] = _Client(principal, Seal(key_id, key, of_leader=True))
        own = [number for number, client in self._clients.items() if client.principal.pin == principal.pin]
        if len(own) > MAX_KEYS_PER_MACHINE:
            self._forget(own[0])
        if len(self._clients) > MAX_KEYS:
            self._forget(next(iter(self._clients)))
        return key_id, key

    def revoke_all_but(self, pins: Collection[str]) -> None:
        """Revoke the keys of all machines except these."""
        for key_id, client in list(self._clients.items()):
            if client.principal.pin not in pins:
                self._forget(key_id)

    def open(self, data: bytes, address: Address) -> tuple[bytes, Principal]:
        """Return a datagram's message and its sender. Raises SealError if it is refused."""
        key_id = key_of(data)
        if (client := self._clients.get(key_id)) is None:
            raise SealError(Refused.UNKNOWN_KEY)
        message = client.seal.open(data)
        # Another client may have had the address in between.
        if self._at.get(address) is not client:
            self._release_address(client)
            client.address, self._at[address] = address, client
        # Move it to the end: the least recently used key is forgotten first.
        self._clients[key_id] = self._clients.pop(key_id)
        return message, client.principal

    def seal(self, message: bytes, address: Address) -> bytes | None:
        """Return the datagram of a message to the client at an address; None if no key is in use there."""
        client = self._at.get(address)
        return None if client is None else client.seal.seal(message)

    def _forget(self, key_id: int) -> None:
        self._release_address(self._clients.pop(key_id))

    def _release_address(self, client: _Client) -> None:
        if client.address is not None and self._at.get(client.address) is client:
            del self._at[client.address]


class LeaderKeys:
    """Keys that leaders have issued to a client."""

    def __init__(self) -> None:
        self.missing: set[Address] = set()
        """Leaders to send to without a key, or with a key that they no longer know."""
        self._seals: dict[Address, Seal] = {}
        self._last: dict[Address, bytes] = {}
        """Last message to each leader; it is sent again once a requested key arrives."""
        self._unsent: dict[Address, bytes] = {}

    def hold(self, leader: Address, grant: Grant) -> None:
        """Use the key of a grant with that leader."""
        self._seals[leader] = Seal(*grant, of_leader=False)
        self.missing.discard(leader)
        if leader in self._last:
            self._unsent[leader] = self._last[leader]

    def seal(self, message: bytes, leader: Address) -> bytes | None:
        """Return the datagram of a message; None if that leader has no key yet.

        The last such message waits for the key.
        """
        self._last[leader] = message
        if leader not in self._seals:
            self.missing.add(leader)
            return None
        return self._seals[leader].seal(message)

    def take_stored(self) -> list[tuple[bytes, Address]]:
        """Return the datagrams of the messages that waited for a key which has arrived."""
        return [(self._seals[leader].seal(self._unsent.pop(leader)), leader) for leader in list(self._unsent)]

    def open(self, data: bytes, leader: Address) -> bytes:
        """Return the message of a leader's datagram. Raises SealError if it is refused."""
        key_id, seal = key_of(data), self._seals.get(leader)
        if seal is None or seal.key_id != key_id:
            raise SealError(Refused.UNKNOWN_KEY)
        return seal.open(data)

    def is_key_of(self, data: bytes, leader: Address) -> bool:
        """Whether a datagram uses that leader's key, or is its notice that the key is unknown."""
        seal, key_id = self._seals.get(leader), unknown_key_of(data)
        try:
            return seal is not None and seal.key_id == (key_of(data) if key_id is None else key_id)
        except SealError:
            return False

    def take_notice(self, leader: Address, notice: bytes, key_id: int) -> bool:
        """Request another key if this leader's notice is about the present key; return whether it is."""
        if (seal := self._seals.get(leader)) is None or seal.key_id != key_id or not seal.has_sent(notice):
            return False
        self.missing.add(leader)
        return True
