"""Trust of a process in other machines: its user's identity, the known machines, and TLS between them."""

import contextlib
import functools
import os
import ssl
from collections.abc import Collection, Iterator
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path

from platformdirs import user_data_path

from capture_app.common.pairing_codes import Role, pin_of
from capture_app.trust.identity import Identity, load_identity
from capture_app.trust.known_machines import CameraNames, KnownMachine, KnownMachines

OPEN_VARIABLE = "SIMULSHOT_OPEN"
"""If 1, pairing is skipped, as with --open: by this process and those that it starts."""
_IN_USE: ContextVar["Trust | None"] = ContextVar("trust", default=None)


@dataclass(frozen=True, slots=True)
class Peer:
    """Machine at the other end of a stream, with its pin, name and roles; without roles it is unknown."""

    pin: str = ""
    name: str = ""
    roles: frozenset[Role] = frozenset()
    via: str = ""
    """Pin of the relay that vouches and speaks for it."""
    node: tuple[str, int] | None = None
    """Name and instance number of its node, as seen by that relay."""

    @property
    def is_unknown(self) -> bool:
        """Whether the machine is unknown, that is, has no role."""
        return not self.roles

    def may(self, role: Role) -> bool:
        """Whether the machine has this role."""
        return role in self.roles


UNKNOWN_PEER = Peer()
ANYBODY = Peer(name="anybody", roles=frozenset(Role))
"""Peer of an open rig, where no machine is authenticated."""


class Trust:
    """Identity and known machines of one folder; `Trust.open()` authenticates nobody and does not encrypt."""

    def __init__(self, folder: Path | None) -> None:
        """`folder` stores the key and the known machines; None: no machine is authenticated."""
        self.folder = folder
        self._server: tuple[int, ssl.SSLContext] | None = None
        self._clients: dict[bool, ssl.SSLContext] = {}

    @classmethod
    def open(cls) -> "Trust":
        """Return the trust of an open rig: every machine may do everything."""
        return cls(None)

    @classmethod
    def of_user(cls) -> "Trust":
        """Return the trust in use here, else this user's, in $XDG_DATA_HOME/simulshot/trust on Linux."""
        if (in_use := _IN_USE.get()) is not None:
            return in_use
        if os.environ.get(OPEN_VARIABLE, "") not in ("", "0"):
            return _of_folder(None)
        return _of_folder(user_data_path("simulshot", appauthor=False) / "trust")

    @contextlib.contextmanager
    def in_use(self) -> Iterator[None]:
        """Use this trust in the block, and in the tasks started there."""
        before = _IN_USE.set(self)
        try:
            yield
        finally:
            _IN_USE.reset(before)

    @property
    def variables(self) -> dict[str, str]:
        """Environment variables that make a child process use the same trust."""
        return {OPEN_VARIABLE: "1"} if self.is_open else {}

    @property
    def is_open(self) -> bool:
        """Whether the rig is open: machines are not authenticated and nothing is encrypted."""
        return self.folder is None

    @functools.cached_property
    def identity(self) -> Identity:
        """Identity of this machine. Raises DiskError, BadInputError."""
        assert self.folder is not None
        return load_identity(self.folder)

    @functools.cached_property
    def known(self) -> KnownMachines:
        """Machines that this one knows."""
        assert self.folder is not None
        return KnownMachines(self.folder)

    def peer(self, certificate: bytes | None) -> Peer:
        """Return the peer with this certificate (DER), whose key TLS has verified.

        This machine itself has all roles.
        """
        if self.is_open:
            return ANYBODY
        return UNKNOWN_PEER if certificate is None else self.peer_of(pin_of(certificate))

    def peer_of(self, pin: str) -> Peer:
        """Return the peer with a pin, as known at present."""
        if pin == self.identity.pin:
            return Peer(pin, "this machine", frozenset(Role))
        machine = self.known.find(pin)
        return Peer(pin) if machine is None else Peer(pin, machine.name, frozenset(machine.roles))

    def roots_of(self, pin: str) -> tuple[str, ...]:
        """Return the pins of the leaders that a relay followed when it was paired; none for a leader."""
        machine = None if self.is_open else self.known.find(pin)
        return () if machine is None else machine.roots

    def take_trust_of(self, leader: Peer, machines: Collection[KnownMachine], names: dict[str, str]) -> None:
        """Adopt the machines that a leader vouches for, and the names' owners if it is also a standby here.

        Raises DiskError, BadInputError.
        """
        self.known.take_trust_of(leader.pin, machines)
        if leader.may(Role.STANDBY) and leader.pin != self.identity.pin and self.folder is not None:
            names_file = CameraNames(self.folder)
            # A name that has an owner here keeps it.
            names_file.owners = {**names, **names_file.owners}
            names_file.keep()

    def server_context(self) -> ssl.SSLContext | None:
        """TLS context for incoming streams; a client without a certificate connects as an unknown peer."""
        if self.is_open:
            return None
        machines = self.known.all()
        if self._server is None or self._server[0] != self.known.version:
            context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
            context.minimum_version = ssl.TLSVersion.TLSv1_3
            context.verify_mode = ssl.CERT_OPTIONAL
            # Each stream authenticates again: a removed machine must have no session to resume.
            context.num_tickets = 0
            context.load_cert_chain(self.identity.file)
            context.load_verify_locations(
                cadata=b"".join(
                    (
                        self.identity.certificate,
                        *(machine.certificate for machine in machines if machine.certificate is not None),
                    )
                )
            )
            self._server = self.known.version, context
        return self._server[1]

    def client_context(self, *, as_unknown: bool = False) -> ssl.SSLContext | None:
        """TLS context for a stream to a leader; the caller must check it with `peer` before sending anything.

        `as_unknown`: without presenting a certificate, to leaders that are not known yet.
        """
        if self.is_open:
            return None
        if as_unknown not in self._clients:
            context = self._clients[as_unknown] = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
            context.minimum_version = ssl.TLSVersion.TLSv1_3
            # The server proves its key; only its pin decides whether that key is accepted.
            context.check_hostname = False
            context.verify_mode = ssl.CERT_NONE
            if not as_unknown:
                context.load_cert_chain(self.identity.file)
        return self._clients[as_unknown]


@functools.cache
def _of_folder(folder: Path | None) -> Trust:
    return Trust(folder)
