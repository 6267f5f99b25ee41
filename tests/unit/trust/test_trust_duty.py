"""What a machine owes those that it knows, in histories of pairings and introductions that are drawn.

Who was confirmed here keeps its roles until it is removed; who was only introduced stays as long as a leader
that was confirmed here introduces it, with no role that this leader cannot give.
"""

import random
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture_app.common.errors import BadInputError
from capture_app.common.pairing_codes import Role
from capture_app.trust import known_machines
from capture_app.trust.known_machines import KnownMachine, KnownMachines

PINS, NAMES = ("aaaa-1", "aaaa-2", "bbbb-3", "cccc-4", "dddd-5", "eeee-6"), ("", "pi", "desk")
MAX_MACHINES = 5


@dataclass
class Known:
    """A machine as it should be known."""

    name: str = ""
    roles: set[Role] = field(default_factory=set)
    voucher: str = ""


class TrustDuty:
    """A machine whose file two processes read; each method is something that happens."""

    def __init__(self, folder: Path, chance: random.Random) -> None:
        self.known, self.elsewhere, self.chance = KnownMachines(folder), KnownMachines(folder), chance
        self.machines: dict[str, Known] = {}
        self.before: dict[str, tuple[str, set[Role], str]] = {}
        """What was known before the last step."""

    def add(self) -> None:
        """A machine is confirmed here."""
        pin, role, name = (self.chance.choice(of) for of in (PINS, [*Role], NAMES))
        if pin not in self.machines and len(self.machines) == MAX_MACHINES:
            with pytest.raises(BadInputError, match="already known"):
                self.known.add(pin, role, name=name)
            return
        added = self.known.add(pin, role, name=name)
        machine = self.machines.pop(pin, Known())
        if name or not machine.name:
            machine.name = self._free(name or "machine")
        machine.roles |= {Role.STANDBY, Role.LEADER, Role.CAMERA} if role is Role.STANDBY else {role}
        machine.voucher = ""
        self.machines[pin] = machine
        assert (added.pin, added.name) == (pin, machine.name)

    def _free(self, name: str) -> str:
        taken = {machine.name for machine in self.machines.values()}
        names = (name, *(f"{name}-{number}" for number in range(2, 9)))
        return next(free for free in names if free not in taken)

    def remove(self) -> None:
        """A machine is removed by its name or pin, with those that it alone introduced."""
        names = {machine.name: pin for pin, machine in self.machines.items()}
        pin = self.chance.choice(PINS)
        which = self.chance.choice([pin.upper(), pin[:4], pin[:3], *names])
        meant = [names[which]] if which in names else [
            pin for pin in self.machines if len(which) >= 4 and pin.startswith(which.lower())
        ]  # fmt: skip
        if len(meant) != 1:
            with pytest.raises(BadInputError, match="more than one" if meant else "no machine"):
                self.known.remove(which)
            return
        assert self.known.remove(which).pin == meant[0]
        self.machines = {
            pin: machine for pin, machine in self.machines.items() if meant[0] not in (pin, machine.voucher)
        }

    def introduce(self) -> None:
        """A machine says which others it knows."""
        leader = self.chance.choice(PINS)
        offered = [
            KnownMachine(
                pin=pin,
                name=self.chance.choice(NAMES),
                roles=tuple(self.chance.sample([*Role], self.chance.randrange(1, 4))),
            )
            for pin in self.chance.sample(PINS, 4)
        ]
        self.known.take_trust_of(leader, offered)
        voucher = self.machines.get(leader)
        if voucher is None or voucher.voucher or Role.LEADER not in voucher.roles:
            return
        allowed = {*Role} if Role.STANDBY in voucher.roles else {Role.LEADER}
        self.machines = {pin: of for pin, of in self.machines.items() if of.voucher != leader}
        for offer in offered:
            roles = allowed & {*offer.roles}
            if roles and offer.pin not in self.machines and len(self.machines) < MAX_MACHINES:
                self.machines[offer.pin] = Known(self._free(offer.name or "machine"), roles, leader)

    def check(self) -> None:
        """See that all processes know the same, and what this machine says of others."""
        expected = {pin: (of.name, {*of.roles}, of.voucher) for pin, of in self.machines.items()}
        version = self.known.version
        assert [self.known.find(pin) is not None for pin in PINS] == [pin in expected for pin in PINS]
        assert self.known.version > version or expected == self.before
        for known in (self.elsewhere, self.known):
            seen = known.all()
            assert {of.pin: (of.name, {*of.roles}, of.vouched_by) for of in seen} == expected
            assert [of.pin for of in seen] == [*expected]
            version = known.version
            assert known.all() == seen
            assert known.version == version
        self.before = expected
        for who in PINS:
            asks, own = self.machines.get(who), {p: of for p, of in self.machines.items() if not of.voucher}
            own.pop(who, None)
            if asks is None or Role.STANDBY not in asks.roles:
                own = {
                    pin: Known(of.name, {Role.LEADER}) for pin, of in own.items() if Role.STANDBY in of.roles
                }
            told = {of.pin: Known(of.name, {*of.roles}) for of in self.known.vouched_for(who)}
            assert told == own


@settings(max_examples=5)
@given(st.integers(0, 2**32))
def test_machines_are_known_as_long_and_for_as_much_as_they_were_let_in(
    tmp_path_factory: pytest.TempPathFactory, seed: int
) -> None:
    duty = TrustDuty(tmp_path_factory.mktemp("known"), random.Random(seed))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(known_machines, "MAX_MACHINES", MAX_MACHINES)
        for step in duty.chance.choices((*[duty.add] * 4, *[duty.introduce] * 4, duty.remove), k=30):
            step()
            duty.check()
