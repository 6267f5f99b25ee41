"""Two machines that a short one-time code makes known to each other: SPAKE2 (RFC 9382), and both confirm.

Who does not know the code learns nothing to try codes with at leisure: each try takes a word with the leader,
and a code is good for a few of them. Both certificates go into the key, so that nobody can sit in between.
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
NO_CODE = "there is no code to join with at present"
WRONG_CODE = "that is not the code"


@dataclass(slots=True)
class Invitation:
    """A code for one machine."""

    code: str
    role: Role
    ends_s: float
    """When the code is good no more, by the clock that the invitations were given."""
    tries_left: int = TRIES


class Invitations:
    """A leader's codes: each for one machine, a few tries and some minutes; several are good side by side.

    The first digit tells which of them is meant, and is no secret.
    """

    def __init__(self, now_s: Callable[[], float]) -> None:
        self._now_s = now_s
        self._invitations: list[Invitation] = []
        """The newest last."""

    def invite(self, role: Role) -> Invitation:
        """Make a code for one machine; those before stay good, up to ten of them."""
        good = self._good()[1 - 10 :]
        free = sorted({*map(str, range(10))} - {one.code[0] for one in good})
        code = f"{secrets.choice(free)}{secrets.randbelow(10 ** (CODE_DIGITS - 1)):0{CODE_DIGITS - 1}d}"
        self._invitations = [*good, Invitation(code, role, self._now_s() + GOOD_FOR_S)]
        return self._invitations[-1]

    @property
    def invitation(self) -> Invitation | None:
        """The newest code that is good now."""
        return next(reversed(self._good()), None)

    def _good(self) -> list[Invitation]:
        return [one for one in self._invitations if one.tries_left > 0 and self._now_s() < one.ends_s]

    def answer(
        self, pin: str, share: bytes, own_pin: str, digit: str = ""
    ) -> tuple[bytes, Invitation, bytes]:
        """Take a machine's word; return the leader's, which code it tries, and the key that it must prove.

        One try is spent.

        `digit` is the first of the code that the machine has; without, the newest is meant.
        Raises UnknownMachineError where no code begins so, BadInputError for what is no such word.
        """
        found = (one for one in reversed(self._good()) if one.code.startswith(digit))
        invitation = next(found, None)
        if invitation is None:
            raise UnknownMachineError(WRONG_CODE if self._good() else NO_CODE, hint=SHOW_CODE)
        invitation.tries_left -= 1
        from spake2 import SPAKE2_B

        half = SPAKE2_B(invitation.code.encode(), idA=pin.encode(), idB=own_pin.encode())
        own_share: bytes = half.start()
        return own_share, invitation, _finish(half, share)

    def accept(self, invitation: Invitation, key: bytes, proof: bytes) -> bytes:
        """Return the leader's own proof for a machine that knew the code, which is spent by that.

        Raises UnknownMachineError where it did not, or another has used the code meanwhile.
        """
        known = any(one is invitation for one in self._invitations)
        current = known and self._now_s() < invitation.ends_s
        if not current or not hmac.compare_digest(proof, _proof(key, b"machine")):
            raise UnknownMachineError(WRONG_CODE, hint=SHOW_CODE)
        self._invitations.remove(invitation)
        return _proof(key, b"leader")


class Candidate:
    """A machine that wants to be known to a leader."""

    def __init__(self, code: str, pin: str, leader_pin: str) -> None:
        """`leader_pin` is that of the certificate which the leader has shown."""
        from spake2 import SPAKE2_A

        self._half = SPAKE2_A(code.encode(), idA=pin.encode(), idB=leader_pin.encode())
        self.share: bytes = self._half.start()
        """The first word of the exchange, for the leader."""
        self._key = b""

    def prove(self, share: bytes) -> bytes:
        """Take the leader's word, and return the proof that the code was known here.

        Raises BadInputError for what is no such word.
        """
        self._key = _finish(self._half, share)
        return _proof(self._key, b"machine")

    def check(self, proof: bytes) -> None:
        """Check that the leader knew the code. Raises UnknownMachineError."""
        if not self._key or not hmac.compare_digest(proof, _proof(self._key, b"leader")):
            raise UnknownMachineError("whoever answers there does not know the code itself")


def _finish(half: Any, share: bytes) -> bytes:
    try:
        key: bytes = half.finish(share)
    except Exception as error:
        raise BadInputError("what came is no word of this pairing") from error
    return key


def _proof(key: bytes, side: bytes) -> bytes:
    return hmac.digest(key, b"simulshot pairing, the " + side, "sha256")
