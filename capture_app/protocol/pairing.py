"""Messages that pair machines, and the leaders that a machine finds to pair with."""

from typing import Annotated

from msgspec import Meta, Struct

from capture_app.common.address import Address
from capture_app.common.names import Name
from capture_app.common.pairing_codes import Role
from capture_app.protocol.message import Message

Certificate = Annotated[bytes, Meta(max_length=4096)]
"""In DER."""
Word = Annotated[bytes, Meta(max_length=64)]


class FoundLeader(Struct, frozen=True):
    """A leader or relay that the network announces, or one of this machine; anybody can announce anything."""

    name: str
    addresses: tuple[Address, ...]
    """Where it may be reached; of one that has answered the one where it did."""
    version: str = ""
    """The version of its simulshot; empty for one of this machine."""
    is_relay: bool = False
    pin: str = ""
    """That it says it has; its streams have to prove it."""
    is_known: bool = True
    """Whether this machine knows a leader of that pin, or asks nobody for a pin."""
    among: tuple[Address, ...] = ()
    """All leaders of its rig as it says, the best first; empty where it is the only one."""


class EnrolRequest(Message, frozen=True, kw_only=True, tag="enrol-request"):
    """A machine whose pin was added at the leader shows the certificate that it is of."""

    certificate: Certificate


class PairingWord(Message, frozen=True, kw_only=True, tag="pairing"):
    """A machine wants to be known by a code; its word of SPAKE2."""

    certificate: Certificate
    name: Name
    share: Word
    digit: Annotated[str, Meta(pattern="^[0-9]?$")] = ""
    """The code's first, which tells it from others that are good."""


class PairingAnswer(Message, frozen=True, kw_only=True, tag="pairing-answer"):
    """The leader's word of SPAKE2."""

    share: Word


class PairingProof(Message, frozen=True, kw_only=True, tag="pairing-proof"):
    """The machine knew the code."""

    proof: Word


class Known(Message, frozen=True, kw_only=True, tag="known"):
    """The machine is known from now on."""

    leader: Name
    """What the leader's machine is called."""
    roles: tuple[Role, ...]
    proof: Word = b""
    """The leader knew the code, too."""


class Invite(Message, frozen=True, kw_only=True, tag="invite"):
    """An operator wants a code for one machine."""

    role: Role = Role.CAMERA


class Invited(Message, frozen=True, kw_only=True, tag="invited"):
    """The code, and how long it is good, in s."""

    code: str
    good_for_s: int


class SpeaksFor(Message, frozen=True, kw_only=True, tag="speaks-for"):
    """A relay says for whom it speaks on this stream: a machine that it knows."""

    pin: str
    name: str
    roles: tuple[Role, ...]
    node: tuple[str, int] | None = None
    """Name and run of the node that it has seen to be of that machine; it reads no more of the stream."""


FromStranger = EnrolRequest | PairingWord | PairingProof
ToStranger = PairingAnswer | Known
