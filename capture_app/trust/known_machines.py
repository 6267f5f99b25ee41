"""The machines that this one knows, by their pins, and what each may do; kept in one file."""

import ssl
import time
from collections.abc import Callable, Collection, Iterable
from pathlib import Path

from msgspec import Struct
from msgspec.structs import replace

from capture_app.common.errors import BadInputError, SimulshotError
from capture_app.common.names import free_name, name_like
from capture_app.common.pairing_codes import Role, pin_of
from capture_app.trust.kept_file import KeptFile

FILE = "machines.json"
MOST = 1000


INCLUDED = {Role.STANDBY: (Role.STANDBY, Role.LEADER, Role.CAMERA)}
"""A standby follows the one that leads as its cameras do, and leads them."""


class KnownMachine(Struct, frozen=True, kw_only=True):
    """A machine that was confirmed once."""

    pin: str
    name: str
    roles: tuple[Role, ...]
    certificate: bytes | None = None
    """The machine's certificate in DER; None until one that was added by its pin has shown it."""
    added_unix_s: int = 0
    vouched_by: str = ""
    """Pin of the leader by whose word alone it is known; empty of one that was confirmed here."""


class KnownMachines:
    """The file of them; what another process has changed in it is seen at the next look."""

    def __init__(self, folder: Path) -> None:
        self._file = KeptFile(
            folder / FILE, tuple[KnownMachine, ...], (), "delete it, and pair the machines again"
        )
        self._seen: tuple[int, int, int] | None = None
        self._machines: tuple[KnownMachine, ...] = ()
        self.version = 0
        """Counts the changes that were seen."""

    def all(self) -> tuple[KnownMachine, ...]:
        """Return all, in the order in which they were added.

        Raises BadInputError for a damaged file, DiskError for one that cannot be read. One that becomes so
        while it is in use changes nothing.
        """
        try:
            state = self._file.path.stat()
        except OSError:
            seen = None
        else:
            seen = state.st_ino, state.st_mtime_ns, state.st_size
        if seen != self._seen:
            try:
                self._machines = self._file.read() if seen is not None else ()
            except SimulshotError:
                if self._seen is None:
                    raise
            self._seen = seen
            self.version += 1
        return self._machines

    def find(self, pin: str) -> KnownMachine | None:
        """Return the machine of a pin."""
        return next((machine for machine in self.all() if machine.pin == pin), None)

    def add(self, pin: str, role: Role, *, name: str = "", certificate: bytes | None = None) -> KnownMachine:
        """Let a machine do this from now on, beside what it may do already.

        Raises DiskError where that cannot be kept, BadInputError for one machine too many, or a certificate
        that is none or not of this pin.
        """
        if certificate is not None:
            _check_certificate(certificate, pin)

        def change(machines: tuple[KnownMachine, ...]) -> Iterable[KnownMachine]:
            others = tuple(machine for machine in machines if machine.pin != pin)
            known = next((machine for machine in machines if machine.pin == pin), None)
            if known is None:
                if len(machines) >= MOST:
                    raise BadInputError(f"{MOST} machines are known already", hint="capture-app trust remove")
                known = KnownMachine(pin=pin, name="", roles=(), added_unix_s=int(time.time()))
            names = {machine.name for machine in others}
            return *others, replace(
                known,
                name=known.name if known.name and not name else free_name(name_like(name, "machine"), names),
                roles=tuple(sorted({*known.roles, *INCLUDED.get(role, (role,))})),
                certificate=certificate or known.certificate,
                vouched_by="",
            )

        return next(machine for machine in self._change(change) if machine.pin == pin)

    def vouched_for(self, who: str) -> tuple[KnownMachine, ...]:
        """Return whom this machine vouches for to one of that pin: standbys; to one of these, all."""
        asks, own = self.find(who), [one for one in self.all() if not one.vouched_by and one.pin != who]
        if asks is not None and Role.STANDBY in asks.roles:
            return tuple(own)
        standbys = (one for one in own if Role.STANDBY in one.roles)
        return tuple(replace(one, roles=(Role.LEADER,), certificate=None) for one in standbys)

    def take_word(self, of: str, told: Collection[KnownMachine]) -> None:
        """Know these machines, and no others, by the word of a leader of that pin, which was confirmed here.

        Only one that is a standby here, too, makes others known than leaders. What was confirmed here, or
        is known by another's word, stays as it is. Raises DiskError, BadInputError.
        """
        voucher = self.find(of)
        if voucher is None or voucher.vouched_by or Role.LEADER not in voucher.roles:
            return
        allowed = set(Role) if Role.STANDBY in voucher.roles else {Role.LEADER}

        def change(machines: tuple[KnownMachine, ...]) -> tuple[KnownMachine, ...]:
            known = {one.pin: one for one in machines if one.vouched_by != of}
            names = {one.name for one in known.values()}
            for one in told:
                roles = tuple(sorted(allowed & {*one.roles}))
                if roles and one.pin not in known and len(known) < MOST:
                    name = free_name(name_like(one.name, "machine"), names)
                    names.add(name)
                    known[one.pin] = replace(one, name=name, roles=roles, vouched_by=of)
            return tuple(known.values())

        for one in told:
            if one.certificate is not None:
                _check_certificate(one.certificate, one.pin)
        if {*change(self.all())} != {*self.all()}:
            self._change(change)

    def note_certificate(self, certificate: bytes) -> KnownMachine | None:
        """Keep the certificate of a machine whose pin was added here; None where it was not."""
        pin = pin_of(certificate)
        known = self.find(pin)
        if known is None or known.certificate is not None:
            return known
        if known.vouched_by:
            return None
        return self.add(pin, known.roles[0], certificate=certificate)

    def remove(self, which: str) -> KnownMachine:
        """Forget a machine, by its name or the beginning of its pin.

        Raises BadInputError where there is none of it, or more than one; DiskError.
        """
        found = [
            machine
            for machine in self.all()
            if machine.name == which or (len(which) >= 4 and machine.pin.startswith(which.lower()))
        ]
        if len(found) != 1:
            what = "no machine" if not found else "more than one machine"
            raise BadInputError(f"{what} here is called {which!r}", hint="see capture-app trust list")
        self._change(lambda machines: (one for one in machines if one.pin != found[0].pin))
        return found[0]

    def _change(
        self, change: Callable[[tuple[KnownMachine, ...]], Iterable[KnownMachine]]
    ) -> tuple[KnownMachine, ...]:
        self._file.change(lambda machines: tuple(change(machines)))
        return self.all()


def _check_certificate(certificate: bytes, pin: str) -> None:
    from cryptography import x509

    try:
        # One that cannot be loaded would keep all others out, and so would bytes after it: all are loaded
        # in a row.
        x509.load_der_x509_certificate(certificate)
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_verify_locations(cadata=certificate)
    except (ssl.SSLError, ValueError) as error:
        raise BadInputError("what a machine showed is no certificate") from error
    if pin_of(certificate) != pin:
        raise BadInputError(f"a certificate is not of the pin {pin}")
