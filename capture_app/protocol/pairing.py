"""Messages of machines that a person makes known to each other, and of relays that speak for them."""

from typing import Annotated

from msgspec import Meta

from capture_app.common.names import Name
from capture_app.common.pairing_codes import Role
from capture_app.protocol.message import Message

Certificate = Annotated[bytes, Meta(max_length=4096)]
"""In DER."""
Word = Annotated[bytes, Meta(max_length=64)]


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
