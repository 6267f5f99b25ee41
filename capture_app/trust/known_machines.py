"""What this user's processes remember of other machines: their pins and roles, and who owns each camera name.

Each is a small JSON file in the folder of keys, which processes change one at a time.
"""

import os
import ssl
import time
from collections.abc import Callable, Collection
from contextlib import suppress
from pathlib import Path
from typing import Generic, TypeVar

import msgspec
from msgspec import Struct
from msgspec.structs import replace

from capture_app.common.errors import BadInputError, DiskError, SimulshotError
from capture_app.common.names import free_name, name_like
from capture_app.common.pairing_codes import Role, pin_of
from capture_app.common.text import UNREADABLE, pretty_json
from capture_app.session.files.durable import write_atomic
from capture_app.session.files.locks import lock_file

FILE, NAMES_FILE = "machines.json", "names.json"
MAX_MACHINES = 1000
T = TypeVar("T")
INCLUDED = {Role.STANDBY: (Role.STANDBY, Role.LEADER, Role.CAMERA)}
"""A standby follows the current leader as cameras do, and may lead them later."""


class StateFile(Generic[T]):
    """Persistent value of type `T`; `empty` if the file does not exist."""

    def __init__(self, path: Path, kind: type[T], empty: T, if_damaged: str) -> None:
        """`if_damaged` is the hint in the error that a damaged file raises."""
        self.path, self._empty, self._if_damaged = path, empty, if_damaged
        self._decoder = msgspec.json.Decoder(kind)

    def read(self) -> T:
        """Return the value. Raises BadInputError for a damaged file, DiskError for an unreadable one."""
        try:
            return self._decoder.decode(self.path.read_bytes())
        except FileNotFoundError:
            return self._empty
        except OSError as error:
            raise DiskError(
                f"cannot read {self.path}: {error.strerror}", hint="check its permissions and the disk"
            ) from error
        except UNREADABLE as error:
            raise BadInputError(f"{self.path} is damaged: {error}", hint=self._if_damaged) from error

    def change(self, change: Callable[[T], T]) -> T:
        """Replace the value by `change` of it, and return that. Raises DiskError, and as `read` does."""
        try:
            lock = lock_file(self.path.with_suffix(".lock"), wait=True)
            try:
                changed = change(self.read())
                write_atomic(self.path, pretty_json(changed))
                return changed
            finally:
                os.close(lock)
        except OSError as error:
            raise DiskError(
                f"cannot write {self.path}: {error.strerror}", hint="check its permissions and free space"
            ) from error


class KnownMachine(Struct, frozen=True, kw_only=True):
    """Machine whose identity was confirmed."""

    pin: str
    name: str
    roles: tuple[Role, ...]
    certificate: bytes | None = None
    """The machine's certificate in DER; None for a machine added by its pin, until it presents the
    certificate.
    """
    added_unix_s: int = 0
    vouched_by: str = ""
    """Pin of the leader that alone vouches for it; empty for a machine confirmed here."""
    roots: tuple[str, ...] = ()
    """Of a relay, when it was paired: pins of the leaders that it followed."""


class KnownMachines:
    """File of the known machines; changes by other processes are noticed at the next access."""

    def __init__(self, folder: Path) -> None:
        self._file = StateFile(
            folder / FILE, tuple[KnownMachine, ...], (), "delete it, and pair the machines again"
        )
        self._seen: tuple[int, int, int] | None = None
        self._by_pin: dict[str, KnownMachine] = {}
        self.version = 0
        """Number of changes noticed."""

    def all(self) -> tuple[KnownMachine, ...]:
        """Return all known machines, in the order in which they were added.

        Raises BadInputError for a damaged file, DiskError for an unreadable one. If the file becomes damaged
        or unreadable later, the machines read before remain.
        """
        self._refresh()
        return tuple(self._by_pin.values())

    def find(self, pin: str) -> KnownMachine | None:
        """Return the machine with a pin, or None. Raises as `all` does."""
        self._refresh()
        return self._by_pin.get(pin)

    def _refresh(self) -> None:
        seen = None
        with suppress(OSError):
            state = self._file.path.stat()
            seen = state.st_ino, state.st_mtime_ns, state.st_size
        if seen != self._seen:
            try:
                self._by_pin = {
                    machine.pin: machine for machine in (self._file.read() if seen is not None else ())
                }
            except SimulshotError:
                if self._seen is None:
                    raise
            self._seen = seen
            self.version += 1

    def add(
        self,
        pin: str,
        role: Role,
        *,
        name: str = "",
        certificate: bytes | None = None,
        roots: tuple[str, ...] | None = None,
    ) -> KnownMachine:
        """Grant a machine a role, in addition to its present ones; `roots` are those that a relay follows.

        Raises DiskError if that cannot be stored, BadInputError for one machine too many, or for a
        certificate that is invalid or does not match the pin.
        """
        if certificate is not None:
            _check_certificate(certificate, pin)

        def change(machines: tuple[KnownMachine, ...]) -> tuple[KnownMachine, ...]:
            others = tuple(machine for machine in machines if machine.pin != pin)
            known = next((machine for machine in machines if machine.pin == pin), None)
            if known is None:
                if len(machines) >= MAX_MACHINES:
                    raise BadInputError(
                        f"{MAX_MACHINES} machines are already known",
                        hint="remove one: capture-app trust remove NAME",
                    )
                known = KnownMachine(pin=pin, name="", roles=(), added_unix_s=int(time.time()))
            return *others, replace(
                known,
                name=known.name
                if known.name and not name
                else free_name(name_like(name, "machine"), {other.name for other in others}),
                roles=tuple(sorted({*known.roles, *INCLUDED.get(role, (role,))})),
                certificate=certificate or known.certificate,
                vouched_by="",
                roots=known.roots if roots is None else roots,
            )

        return next(machine for machine in self._file.change(change) if machine.pin == pin)

    def vouched_for(self, who: str) -> tuple[KnownMachine, ...]:
        """Return the machines to vouch for to the machine `who` (a pin): all to a standby, else standbys."""
        asks = self.find(who)
        own = [machine for machine in self.all() if not machine.vouched_by and machine.pin != who]
        if asks is not None and Role.STANDBY in asks.roles:
            return tuple(own)
        return tuple(
            replace(machine, roles=(Role.LEADER,), certificate=None)
            for machine in own
            if Role.STANDBY in machine.roles
        )

    def take_trust_of(self, leader: str, offered: Collection[KnownMachine]) -> None:
        """Replace the machines that the leader with pin `of` vouches for by `offered`.

        Nothing changes unless that leader was confirmed here. A leader that is also a standby here may
        introduce machines with any role, another one only leaders. Machines confirmed here, or known through
        another leader, are unchanged. Raises DiskError, BadInputError.
        """
        if (voucher := self.find(leader)) is None or voucher.vouched_by or Role.LEADER not in voucher.roles:
            return
        allowed = set(Role) if Role.STANDBY in voucher.roles else {Role.LEADER}

        def change(machines: tuple[KnownMachine, ...]) -> tuple[KnownMachine, ...]:
            known = {machine.pin: machine for machine in machines if machine.vouched_by != leader}
            names = {machine.name for machine in known.values()}
            for offer in offered:
                roles = tuple(sorted(allowed & {*offer.roles}))
                if roles and offer.pin not in known and len(known) < MAX_MACHINES:
                    name = free_name(name_like(offer.name, "machine"), names)
                    names.add(name)
                    known[offer.pin] = replace(offer, name=name, roles=roles, vouched_by=leader)
            return tuple(known.values())

        for offer in offered:
            if offer.certificate is not None:
                _check_certificate(offer.certificate, offer.pin)
        if {*change(self.all())} != {*self.all()}:
            self._file.change(change)

    def note_certificate(self, certificate: bytes) -> KnownMachine | None:
        """Store the certificate of a machine that was added by its pin; return None if it was not."""
        pin = pin_of(certificate)
        if (known := self.find(pin)) is None or known.certificate is not None:
            return known
        return None if known.vouched_by else self.add(pin, known.roles[0], certificate=certificate)

    def remove(self, which: str) -> KnownMachine:
        """Remove a machine, given by its name or the beginning of its pin, and those it alone vouches for.

        Raises BadInputError if no machine matches, or more than one; DiskError.
        """
        machines = [
            machine
            for machine in self.all()
            if machine.name == which or (len(which) >= 4 and machine.pin.startswith(which.lower()))
        ]
        if len(machines) != 1:
            raise BadInputError(
                f"{'more than one' if machines else 'no'} machine here is called {which!r}",
                hint="see capture-app trust list",
            )
        oldest = machines[0].pin
        self._file.change(
            lambda known: tuple(
                machine for machine in known if oldest not in (machine.pin, machine.vouched_by)
            )
        )
        return machines[0]


def _check_certificate(certificate: bytes, pin: str) -> None:
    from cryptography import x509

    try:
        # All certificates are loaded in one call: an unreadable one, or trailing bytes, would exclude all
        # others.
        x509.load_der_x509_certificate(certificate)
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_verify_locations(cadata=certificate)
    except (ssl.SSLError, ValueError) as error:
        raise BadInputError(
            "a machine presented an invalid certificate", hint="pair it again: capture-app trust invite"
        ) from error
    if pin_of(certificate) != pin:
        raise BadInputError(
            f"a certificate does not match the pin {pin}", hint="pair it again: capture-app trust invite"
        )


class CameraNames:
    """File that records which machine owns each camera name, shared by all leaders of one user."""

    def __init__(self, folder: Path) -> None:
        """Raises BadInputError if the file is damaged, DiskError if it cannot be read."""
        self._file = StateFile(
            folder / NAMES_FILE,
            dict[str, str],
            {},
            "delete it: the first machine to use a name owns it again",
        )
        self.owners = dict(self._file.read())
        """Pin of the machine of each name; the leader changes it, and `keep` stores it."""
        self._stored = dict(self.owners)

    @property
    def is_stored(self) -> bool:
        """Whether the file has all changes."""
        return self.owners == self._stored

    def keep(self) -> None:
        """Store the changes, blocking on the disk. Raises DiskError if that fails; the next call tries again.

        It may run in a thread while the leader goes on changing the owners.
        """
        if (now := dict(self.owners)) != self._stored:
            removed = self._stored.keys() - now.keys()
            changed = {name: pin for name, pin in now.items() if self._stored.get(name) != pin}
            self._file.change(lambda all_: {n: p for n, p in all_.items() if n not in removed} | changed)
            self._stored = now
