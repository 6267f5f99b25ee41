"""Pairing of two machines by a short one-time code: SPAKE2 (RFC 9382) with key confirmation on both sides.

An attacker without the code cannot try codes offline: each try takes an exchange with the leader, and a code
allows only a few. Both certificates enter the key, which prevents a man in the middle.
"""

import hmac
import secrets
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from capture_app.common.errors import BadInputError, UnknownMachineError
from capture_app.common.pairing_codes import CODE_DIGITS, SHOW_CODE, Role

TRIES = 3
GOOD_FOR_S = 600
WRONG_CODE = "wrong pairing code"


@dataclass(slots=True)
class Invitation:
    """One-time code for one machine."""

    code: str
    role: Role
    ends_s: float
    """Time at which the code expires, in s of the clock of its `Invitations`."""
    tries_left: int = TRIES


class Invitations:
    """One-time codes of a leader, each for one machine; several may be valid at once.

    A code allows a few tries within some minutes. Its first digit selects it, and is not secret.
    """

    def __init__(self, now_s: Callable[[], float]) -> None:
        self._now_s = now_s
        self._invitations: list[Invitation] = []
        """All codes, newest last."""

    def invite(self, role: Role) -> Invitation:
        """Make a code for one machine; earlier codes remain valid, up to ten in all."""
        good = self._good()[1 - 10 :]
        free = sorted({*map(str, range(10))} - {invitation.code[0] for invitation in good})
        code = f"{secrets.choice(free)}{secrets.randbelow(10 ** (CODE_DIGITS - 1)):0{CODE_DIGITS - 1}d}"
        self._invitations = [*good, Invitation(code, role, self._now_s() + GOOD_FOR_S)]
        return self._invitations[-1]

    def _good(self) -> list[Invitation]:
        return [
            invitation
            for invitation in self._invitations
            if invitation.tries_left > 0 and self._now_s() < invitation.ends_s
        ]

    def answer(
        self, pin: str, spake2_message: bytes, own_pin: str, digit: str = ""
    ) -> tuple[bytes, Invitation, bytes]:
        """Answer a machine's SPAKE2 message; spend one try of its code.

        Return the leader's message, the code used, and the key that the machine must prove. `digit` is the
        first digit of the machine's code; without it the newest code is used. Raises UnknownMachineError if
        no valid code begins with it, BadInputError for an invalid message.
        """
        good = self._good()
        invitation = next((one for one in reversed(good) if one.code.startswith(digit)), None)
        if invitation is None:
            raise UnknownMachineError(
                WRONG_CODE if good else "no pairing code is valid at present", hint=SHOW_CODE
            )
        invitation.tries_left -= 1
        from spake2 import SPAKE2_B

        half = SPAKE2_B(invitation.code.encode(), idA=pin.encode(), idB=own_pin.encode())
        return half.start(), invitation, _finish(half, spake2_message)

    def accept(self, invitation: Invitation, key: bytes, proof: bytes) -> bytes:
        """Return the leader's proof for a machine that proved that it knows the code; the code is then spent.

        Raises UnknownMachineError for a wrong proof, or if the code has expired or was used by another
        machine.
        """
        is_open = (
            any(known is invitation for known in self._invitations) and self._now_s() < invitation.ends_s
        )
        if not is_open or not hmac.compare_digest(proof, _proof(key, b"machine")):
            raise UnknownMachineError(WRONG_CODE, hint=SHOW_CODE)
        self._invitations.remove(invitation)
        return _proof(key, b"leader")


class Candidate:
    """Machine that asks a leader to pair with it."""

    def __init__(self, code: str, pin: str, leader_pin: str) -> None:
        """`leader_pin` is the pin of the certificate that the leader presented."""
        from spake2 import SPAKE2_A

        self._half = SPAKE2_A(code.encode(), idA=pin.encode(), idB=leader_pin.encode())
        self.spake2_message: bytes = self._half.start()
        """First SPAKE2 message, for the leader."""
        self._key = b""

    def prove(self, spake2_message: bytes) -> bytes:
        """Process the leader's message, and return the proof that this machine knows the code.

        Raises BadInputError for an invalid message.
        """
        self._key = _finish(self._half, spake2_message)
        return _proof(self._key, b"machine")

    def check(self, proof: bytes) -> None:
        """Check the proof that the leader knew the code. Raises UnknownMachineError."""
        if not self._key or not hmac.compare_digest(proof, _proof(self._key, b"leader")):
            raise UnknownMachineError("the machine that answers does not know the code", hint=SHOW_CODE)


def _finish(half: Any, spake2_message: bytes) -> bytes:
    try:
        return bytes(half.finish(spake2_message))
    except Exception as error:
        raise BadInputError("invalid pairing message") from error


def _proof(key: bytes, side: bytes) -> bytes:
    return hmac.digest(key, b"simulshot pairing, the " + side, "sha256")
