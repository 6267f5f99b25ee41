"""Admission of devices: by a one-time secret first, then by the key that the device generated itself."""

import hashlib
import re
import secrets
from collections.abc import Callable
from dataclasses import dataclass

from capture_app.common.errors import UnknownMachineError
from capture_app.common.names import free_name, name_like

SECRET_BYTES = 16
GOOD_FOR_S = 600.0
TICKET_S = 30.0
"""Validity of the ticket between a device's admission and its link."""
MAX_DEVICES = 64
_KEY = re.compile(r"[0-9a-f]{32}")


@dataclass(frozen=True, slots=True)
class Admitted:
    """An admitted device: its name, and the digest of its key."""

    name: str
    """Its name in the rig; the same every time the device reconnects."""
    key: str
    """Digest of the key by which the device identifies itself."""


class Admission:
    """Keeps one invitation open, and remembers in memory which device used which secret."""

    def __init__(self, now_s: Callable[[], float], kind: str = "phone") -> None:
        """Create an admission without devices; `now_s` is a monotonic clock, `kind` the devices' kind."""
        self._now_s, self._kind = now_s, kind
        self._secret, self._until_s = "", 0.0
        self._spent: dict[str, str] = {}
        """Digest of each used secret to the digest of the key of the device that used it."""
        self._devices: dict[str, Admitted] = {}
        self._tickets: dict[str, tuple[Admitted, float]] = {}
        self._put_off: set[str] = set()
        """Digests of the keys of devices that were removed from the rig."""

    @property
    def secret(self) -> str:
        """Secret for the next device; renewed once it is used or has expired."""
        if not self._secret or self._now_s() >= self._until_s:
            self._renew()
        return self._secret

    @property
    def good_for_s(self) -> int:
        """Remaining validity of the current secret, in s."""
        return max(0, round(self._until_s - self._now_s()))

    def admit(self, secret: str, key: str, requested_name: str) -> Admitted:
        """Admit a device by a secret, or by the key that it used before.

        `requested_name` is the name that its user asks for. Raises UnknownMachineError with a message for
        that user.
        """
        if not _KEY.fullmatch(key):
            raise UnknownMachineError(
                "This page belongs to another leader: scan the code that this leader shows."
            )
        digest, offered = _digest(key), _digest(secret)
        if digest in self._devices:
            # It may have another secret by now, which stays valid for the next phone.
            return self._devices[digest]
        if digest in self._put_off and (not secret or offered in self._spent):
            raise UnknownMachineError(
                f"The leader has removed this {self._kind}. To return, scan the code that it shows now."
            )
        if not secret:
            raise UnknownMachineError(
                f"This {self._kind} is not known here yet: scan the code that the leader shows."
            )
        if offered in self._spent:
            raise UnknownMachineError(
                f"Another {self._kind} has used this code; each works once. "
                "Scan the code that the leader shows now."
            )
        if not secrets.compare_digest(offered, _digest(self.secret)):
            raise UnknownMachineError(
                "This code was mistyped or has expired: scan the one that the leader shows now."
            )
        if len(self._devices) >= MAX_DEVICES:
            remedies = {"phone": "remove one by capture-app cameras remove NAME"}
            remedy = remedies.get(self._kind, "end and restart capture-app monitor")
            raise UnknownMachineError(
                f"{MAX_DEVICES} {self._kind}s are already connected: {remedy} on the leader's machine."
            )
        taken = {device.name for device in self._devices.values()}
        name = free_name(name_like(requested_name.strip()[:40], self._kind), taken)
        admitted = self._devices[digest] = Admitted(name, digest)
        self._spent[offered] = digest
        self._renew()
        return admitted

    def put_off(self, admitted: Admitted) -> None:
        """Remove a device, which is then admitted by a new secret only."""
        self._put_off.add(admitted.key)
        self._devices.pop(admitted.key, None)

    def ticket(self, admitted: Admitted) -> str:
        """Return a ticket that opens one link of that device within TICKET_S."""
        now_s = self._now_s()
        self._tickets = {text: held for text, held in self._tickets.items() if held[1] > now_s}
        ticket = secrets.token_urlsafe(SECRET_BYTES)
        self._tickets[ticket] = admitted, now_s + TICKET_S
        return ticket

    def redeem(self, ticket: str) -> Admitted | None:
        """Return the device whose link a ticket opens; None for an unknown or expired ticket."""
        admitted, until_s = self._tickets.pop(ticket, (None, 0.0))
        return admitted if self._now_s() < until_s else None

    def _renew(self) -> None:
        self._secret, self._until_s = secrets.token_urlsafe(SECRET_BYTES), self._now_s() + GOOD_FOR_S


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode(errors="replace")).hexdigest()
