"""Seals of datagrams: a keyed BLAKE2s (RFC 7693) over each datagram, with a number that is accepted once.

2 bytes   b"sS", 1 byte the version, 1 byte the kind
4 bytes   number of the key, assigned by its issuer
8 bytes   number of this datagram, big-endian; a key never seals two of the same number
message   a datagram of `capture_app.sync.wire.codec`
16 bytes  the seal of all before

A seal does not hide names and times, but no one can alter, forge or replay a datagram. The hash state after
the key is cached, so a time message costs one block of the hash between its timestamp and the socket. Refused
datagrams are counted and reported at intervals.
"""

from collections import Counter
from dataclasses import dataclass
from enum import StrEnum
from hashlib import blake2s
from hmac import compare_digest
from typing import ClassVar

from capture_app.sync.wire.codec import MAGIC, VERSION

KEY_BYTES, SEAL_BYTES = 32, 16
WINDOW = 2048
"""Size of the replay window: a datagram is refused once that many newer ones have arrived."""
KIND_SEALED, KIND_UNKNOWN_KEY = 4, 5
HEAD_BYTES = 16
OVERHEAD_BYTES = HEAD_BYTES + SEAL_BYTES
_MASK = (1 << WINDOW) - 1
_SEALED = MAGIC + bytes([VERSION, KIND_SEALED])
_UNKNOWN_KEY = MAGIC + bytes([VERSION, KIND_UNKNOWN_KEY])
REPORT_INTERVAL_NS = 10_000_000_000
FEW = 10
"""Minimum count of replays, or of keys from before a restart, that is reported; fewer occur in normal use."""
MAX_KINDS = 32
"""Maximum number of hosts and reasons counted separately between two reports."""


class Refused(StrEnum):
    """Reason why a datagram is refused."""

    UNSEALED = "not sealed"
    UNKNOWN_KEY = "sealed with an unknown key"
    FORGED = "forged or altered"
    REPLAYED = "sent before"
    NOT_ITS_OWN = "in the name of another"


class SealError(ValueError):
    """Datagram that is refused, and the reason."""

    def __init__(self, why: Refused) -> None:
        super().__init__(str(why))
        self.why = why


class ReplayWindow:
    """Replay window: accepts each datagram number once, and old ones no longer (as in RFC 4303, 3.4.3)."""

    def __init__(self) -> None:
        self._newest = 0
        self._seen = 0
        """Bit mask of the newest numbers; the lowest bit is the newest number."""

    def is_new(self, number: int) -> bool:
        """Whether a number is within the window and has not arrived yet."""
        behind = self._newest - number
        return behind < 0 or (behind < WINDOW and not self._seen >> behind & 1)

    def add(self, number: int) -> None:
        """Record a number, which must be new."""
        ahead = number - self._newest
        if ahead > 0:
            self._seen = (self._seen << ahead | 1) & _MASK if ahead < WINDOW else 1
            self._newest = number
        else:
            self._seen |= 1 << -ahead


class Seal:
    """One end of a key: seals outgoing datagrams, and opens each incoming one once."""

    def __init__(self, key_id: int, key: bytes, *, of_leader: bool) -> None:
        """Create the leader's or the client's end of a `key` of KEY_BYTES.

        The seals of both ends differ, so that none can be reflected to its sender.
        """
        self.key_id = key_id
        self._head = _SEALED + key_id.to_bytes(4, "big")
        self._sent = 0
        self._window = ReplayWindow()
        own, other = (b"leader", b"client") if of_leader else (b"client", b"leader")
        self._sealing, self._opening = _keyed(key, own), _keyed(key, other)

    def seal(self, message: bytes) -> bytes:
        """Seal a message and return the datagram to send."""
        self._sent = number = self._sent + 1
        data = self._head + number.to_bytes(8, "big") + message
        state = self._sealing.copy()
        state.update(data)
        return data + state.digest()

    def open(self, data: bytes) -> bytes:
        """Return the message of a datagram. Raises SealError if it is forged or a replay."""
        if key_of(data) != self.key_id:
            raise SealError(Refused.UNKNOWN_KEY)
        number = int.from_bytes(data[8:16], "big")
        state = self._opening.copy()
        state.update(data[:-SEAL_BYTES])
        if not compare_digest(state.digest(), data[-SEAL_BYTES:]):
            raise SealError(Refused.FORGED)
        if not self._window.is_new(number):
            raise SealError(Refused.REPLAYED)
        self._window.add(number)
        return data[HEAD_BYTES:-SEAL_BYTES]

    def has_sent(self, notice: bytes) -> bool:
        """Whether a notice of an unknown key answers a datagram that was sealed here recently."""
        return self._sent - WINDOW < int.from_bytes(notice[8:16], "big") <= self._sent


def key_of(data: bytes) -> int:
    """Return the number of a datagram's key. Raises SealError if it is not sealed."""
    if len(data) < OVERHEAD_BYTES or data[:4] != _SEALED:
        raise SealError(Refused.UNSEALED)
    return int.from_bytes(data[4:8], "big")


def unknown_key(data: bytes) -> bytes:
    """Return the notice that a datagram's key is unknown; it is shorter, and not authenticated."""
    return _UNKNOWN_KEY + data[4:HEAD_BYTES]


def unknown_key_of(data: bytes) -> int | None:
    """Return the key number of such a notice; None for any other datagram."""
    is_notice = len(data) == HEAD_BYTES and data[:4] == _UNKNOWN_KEY
    return int.from_bytes(data[4:8], "big") if is_notice else None


def _keyed(key: bytes, end: bytes) -> "blake2s":
    if len(key) != KEY_BYTES:
        raise ValueError(f"a key of {len(key)} bytes, not {KEY_BYTES}")
    return blake2s(key=key, digest_size=SEAL_BYTES, person=end)


@dataclass(frozen=True, slots=True)
class DatagramsRefused:
    """Count of refused datagrams from one host since the last report, and the reason."""

    host: str
    why: Refused
    count: int

    name: ClassVar[None] = None
    """Refused datagrams belong to no known camera."""

    def __str__(self) -> str:
        what = "a datagram" if self.count == 1 else f"{self.count} datagrams"
        return f"refused {what} from {self.host}: {self.why}"


class Refusals:
    """Counts of refused datagrams; `now_ns` is the node's own clock."""

    def __init__(self) -> None:
        self.counts: Counter[tuple[str, Refused]] = Counter()
        """Refused datagrams since the last report, by host and reason."""
        self._due_ns: int | None = None

    def add(self, host: str, why: Refused) -> None:
        """Count a datagram that was refused from a host."""
        is_counted = (host, why) in self.counts or len(self.counts) < MAX_KINDS
        self.counts[host if is_counted else "other hosts", why] += 1

    def take_events(self, now_ns: int) -> list[DatagramsRefused]:
        """Return the refusals since the last report, unless that was less than REPORT_INTERVAL_NS ago."""
        if self._due_ns is not None and now_ns < self._due_ns:
            return []
        reported = [
            (host, why)
            for (host, why), count in self.counts.items()
            if count >= FEW or why not in (Refused.UNKNOWN_KEY, Refused.REPLAYED)
        ]
        if reported:
            self._due_ns = now_ns + REPORT_INTERVAL_NS
        return [DatagramsRefused(*key, self.counts.pop(key)) for key in reported]
