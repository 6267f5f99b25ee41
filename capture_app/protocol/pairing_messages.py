"""Messages that pair machines, and the discovered leaders to pair with."""

from typing import Annotated

from msgspec import Meta, Struct

from capture_app.common.address import Address
from capture_app.common.bounds import Instance, Message, Text
from capture_app.common.names import Name
from capture_app.common.pairing_codes import Role
from capture_app.sync.wire.datagrams import Pin

Certificate = Annotated[bytes, Meta(max_length=4096)]
"""Certificate in DER."""
Spake2Message = Annotated[bytes, Meta(max_length=64)]


class FoundLeader(Struct, frozen=True):
    """Leader or relay announced on the network, or run by this machine; announcements can be forged."""

    name: str
    addresses: tuple[Address, ...]
    """Addresses to try; for a leader that has answered, the address that did."""
    version: str = ""
    """Version of its simulshot; empty for a leader of this machine."""
    is_relay: bool = False
    key: str = ""
    """Announced pin, which its streams have to prove; in an open rig, the instance number of its run."""
    is_known: bool = True
    """Whether this machine knows a leader with that pin, or does not authenticate machines."""
    among: tuple[Address, ...] = ()
    """Announced addresses of all leaders of its rig, preferred first; empty if it is the only one."""


class EnrolRequest(Message, frozen=True, kw_only=True, tag="enrol-request"):
    """Certificate of a machine whose pin was added at the leader."""

    certificate: Certificate


class PairingMessage(Message, frozen=True, kw_only=True, tag="pairing"):
    """SPAKE2 message of a machine that pairs by a code."""

    certificate: Certificate
    name: Name
    spake2_message: Spake2Message
    digit: Annotated[str, Meta(pattern="^[0-9]?$")] = ""
    """First digit of the code, which selects it among several valid ones."""


class PairingAnswer(Message, frozen=True, kw_only=True, tag="pairing-answer"):
    """SPAKE2 message of the leader."""

    spake2_message: Spake2Message


class PairingProof(Message, frozen=True, kw_only=True, tag="pairing-proof"):
    """Proof that the machine knew the code."""

    proof: Spake2Message


class Known(Message, frozen=True, kw_only=True, tag="known"):
    """Confirmation that the machine is now known."""

    leader: Name
    """Name of the leader's machine."""
    roles: Annotated[tuple[Role, ...], Meta(max_length=len(Role))]
    proof: Spake2Message = b""
    """Proof that the leader also knew the code."""
    roots: Annotated[tuple[Pin, ...], Meta(max_length=20)] = ()
    """From a relay: the pins of the leaders that it follows, whose signatures confirm images."""


class Invite(Message, frozen=True, kw_only=True, tag="invite"):
    """Operator's request for a code for one machine."""

    role: Role = Role.CAMERA


class Invited(Message, frozen=True, kw_only=True, tag="invited"):
    """One-time code, and its validity in s."""

    code: str
    good_for_s: int


class SpeaksFor(Message, frozen=True, kw_only=True, tag="speaks-for"):
    """Relay's statement for which known machine it speaks on this stream."""

    pin: Pin
    name: Text
    roles: Annotated[tuple[Role, ...], Meta(max_length=len(Role))]
    node: tuple[Name, Instance] | None = None
    """Name and instance number of the node seen on that machine; the relay reads no more of the stream."""


FromUnknown = EnrolRequest | PairingMessage | PairingProof
ToUnknown = PairingAnswer | Known
