"""The members of a leader: their numbers and slots, and who of them has fallen silent."""

import random
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import takewhile

from msgspec import structs

from capture_app.common.camera_facts import CameraFacts
from capture_app.common.names import is_name
from capture_app.common.node_state import WITHOUT_CAMERA, NodeState
from capture_app.common.timeouts import CLIENT_SILENT_NS, FORGET_LOST_NS
from capture_app.sync.engine import Address
from capture_app.sync.phase.grid_phase_choice import WEIGHTS, CameraPhase
from capture_app.sync.rig.events import NodeChanged
from capture_app.sync.wire.messages import (
    MAX_DEPTH,
    MAX_PERIOD_NS,
    MIN_PERIOD_NS,
    MOST_TEXT,
    PROBE_NUMBER,
    Hello,
    Report,
)
from capture_app.sync.wire.principal import Principal

MAX_CLIENTS = 32_000
MOST_OF_ONE = 100
"""How many names one machine has: it takes no room of others."""


@dataclass(slots=True)
class Member:
    """A client that is or was here, lost or alive."""

    name: str
    instance: int
    number: int
    address: Address
    camera: CameraFacts
    report: Report
    last_heard_ns: int
    slot: float
    via: str | None = None
    """The relay that it joined, where that speaks for it."""
    lost: str = ""
    """Why it is counted as lost; empty while it is here."""
    is_confirmed: bool = False
    """Whether it has said more than hello, by the number that it was told: it is where it says it is."""
    principal: Principal | None = None
    """Who seals its messages; None in a rig without seals."""
    pin: str = ""
    """That of its machine, whoever seals for it."""

    def is_of_another_machine(self, hello: Hello) -> bool:
        """Whether a hello comes from another machine than this member's."""
        return self.pin not in ("", hello.pin)


def camera_phases(members: Iterable[Member]) -> list[CameraPhase]:
    """Return the phases of those members that are here, as they have reported them."""
    return [
        CameraPhase(
            member.name,
            member.camera.phase_control,
            member.report.frame_leader_ns,
            member.report.drift_ppm or 0.0,
            max(1, member.report.tolerance_ns),
        )
        for member in members
        if not member.lost
    ]


def relays_above(member: Member, members: Mapping[str, Member]) -> Iterator[Member]:
    """Yield the relays through which a member has joined, the nearest first, as far as they are known."""
    above = members.get(member.via or "")
    for _ in range(MAX_DEPTH):
        if above is None:
            return
        yield above
        above = members.get(above.via or "")


def van_der_corput(index: int) -> float:
    """Return a number from 0 to 1 that is far from those of the indices around it (van der Corput 1935)."""
    part, step = 0.0, 0.5
    while index:
        part += step * (index & 1)
        index, step = index >> 1, step / 2.0
    return part


class Roster:
    """All members by name; the lost ones stay for FORGET_LOST_NS, so that they can return."""

    def __init__(self, rng: random.Random, owners: dict[str, str] | None = None) -> None:
        self.members: dict[str, Member] = {}
        self.owners = {} if owners is None else owners
        """By each name that was ever taken, the pin of its machine; of a relay, which asks above, none."""
        self.immovable: dict[str, Member] = {}
        """Members whose streams cannot be moved to every grid: the grid is moved to suit them."""
        self.present_count = 0
        """How many are not lost."""
        self.pollers = 0
        """How many present members ask this leader for the time, not a relay."""
        self._rng = rng
        self._by_number: dict[int, Member] = {}
        self._unconfirmed: dict[str, Member] = {}
        """Members that have said no more than hello, the oldest first."""
        self._joins = 0
        self._silence_ns = self._forget_ns = 0
        """No member can have been silent for too long, or lost for too long, before these times."""

    def by_name(self) -> tuple[Member, ...]:
        """Return all that are or were here, in the order of their names; lost ones say so in their report."""
        return tuple(member for _, member in sorted(self.members.items()))

    def member_by_number(self, number: int) -> Member | None:
        """Return the member of that number, None where there is none or it is lost."""
        member = self._by_number.get(number)
        return None if member is None or member.lost else member

    def is_of_another_machine(self, hello: Hello) -> bool:
        """Whether the name that a client asks for is that of another machine's."""
        member = self.members.get(hello.name)
        if member is not None and member.is_of_another_machine(hello):
            return True
        return self.owners.get(hello.name, hello.pin) != hello.pin

    def refusal(self, hello: Hello) -> str:
        """Return why a client cannot be taken in, empty where it can."""
        known = self.members.get(hello.name)
        if self.is_of_another_machine(hello):
            return (
                f"two machines are called {hello.name}: give this one another --name; or, when the other is"
                f" off for good, on the leader: capture-app cameras remove {hello.name}"
            )[:MOST_TEXT]
        if known is not None and not known.lost and known.instance != hello.instance:
            return f"another camera named {hello.name} is here: give this one another --name"
        if not is_name(hello.name):
            return "its name is not a valid name"
        if known is None and self._is_full(hello.pin) and self._least_needed(hello.pin) is None:
            return f"its machine has {MOST_OF_ONE} cameras here already"
        if known is None and len(self.members) >= MAX_CLIENTS and self._least_needed() is None:
            return "the rig is full"
        if not MIN_PERIOD_NS <= hello.camera.period_ns <= MAX_PERIOD_NS:
            return f"a frame period of {hello.camera.period_ns} ns is not possible"
        return ""

    def claim(self, hello: Hello) -> None:
        """Keep whose name it is for good; of what one machine had long ago the first is free again."""
        if self.owners.get(hello.name) != hello.pin:
            self.owners[hello.name] = hello.pin
            gone = [
                name for name, pin in self.owners.items() if pin == hello.pin and name not in self.members
            ]
            for name in gone[:-MOST_OF_ONE]:
                del self.owners[name]

    def confirm(self, member: Member) -> bool:
        """Note that a member has said more than hello; whether that is new."""
        first, member.is_confirmed = not member.is_confirmed, True
        self._unconfirmed.pop(member.name, None)
        return first

    def make_room(self, hello: Hello) -> list[NodeChanged]:
        """Forget one that is not needed where a new client that is not refused would be one too many."""
        if hello.name in self.members:
            return []
        forgotten: list[NodeChanged] = []
        for pin in (hello.pin, ""):
            full = self._is_full(pin) if pin else len(self.members) >= MAX_CLIENTS
            member = self._least_needed(pin) if full else None
            if member is not None:
                forgotten.append(self.forget(member))
        return forgotten

    def _is_full(self, pin: str) -> bool:
        return bool(pin) and sum(member.pin == pin for member in self.members.values()) >= MOST_OF_ONE

    def _least_needed(self, pin: str = "") -> Member | None:
        """Return one that has said no more than hello, else the one that has been lost for the longest.

        Of one machine, where its `pin` is given.
        """
        for member in self._unconfirmed.values():
            if pin in ("", member.pin):
                return member
        lost = (member for member in self.members.values() if member.lost and pin in ("", member.pin))
        return min(lost, key=lambda member: member.last_heard_ns, default=None)

    def admit(
        self, hello: Hello, address: Address, now_ns: int, principal: Principal | None = None
    ) -> tuple[Member, NodeChanged | None]:
        """Add a client that is not refused; no event where it is here already and merely asks again."""
        known = self.members.get(hello.name)
        moved = known is not None and not known.lost
        if known is not None:
            if not known.lost and known.via == hello.via:
                known.last_heard_ns, known.principal = now_ns, principal
                # It may expose otherwise now, and have learnt more of its stamps.
                known.camera = structs.replace(
                    known.camera, stamp=hello.camera.stamp, exposure_ns=hello.camera.exposure_ns
                )
                return known, None
            # A relay that it has left knows it by the old number, and is told that this is unknown.
            self._by_number.pop(known.number, None)
            self._count(known, -1)
        number = self._free_number()
        report, slot = Report(state=NodeState.JOINING), van_der_corput(self._joins)
        member = Member(
            hello.name, hello.instance, number, address, hello.camera, report, now_ns, slot, hello.via
        )
        member.principal, member.pin = principal, hello.pin
        self._joins += 1
        self._count(member, 1)
        self._silence_ns = min(self._silence_ns, now_ns + CLIENT_SILENT_NS)
        self.members[hello.name] = self._by_number[number] = member
        self._unconfirmed.pop(hello.name, None)
        if known is not None and known.instance == hello.instance and known.is_confirmed:
            # It has moved, or returns: nobody else knows its run.
            member.is_confirmed = True
        else:
            self._unconfirmed[hello.name] = member
        self.immovable.pop(hello.name, None)
        if hello.camera.phase_control in WEIGHTS and hello.camera.kind not in WITHOUT_CAMERA:
            self.immovable[hello.name] = member
        if moved:
            return member, NodeChanged(hello.name, "moved", where=hello.via or "")
        return member, NodeChanged(hello.name, "joined" if known is None else "returned")

    def mark_lost(self, member: Member, reason: str) -> NodeChanged:
        """Count a member as lost; its counts of frames stay."""
        self._count(member, -1)
        member.lost = reason
        member.report = Report(
            state=NodeState.LOST, message=reason, frames=member.report.frames, drops=member.report.drops
        )
        self._forget_ns = min(self._forget_ns, member.last_heard_ns + FORGET_LOST_NS)
        return NodeChanged(member.name, "lost", reason)

    def forget(self, member: Member) -> NodeChanged:
        """Forget a member as if it had never been here."""
        self._count(member, -1)
        self._by_number.pop(member.number, None)
        self._unconfirmed.pop(member.name, None)
        self.immovable.pop(member.name, None)
        del self.members[member.name]
        return NodeChanged(member.name, "forgotten")

    def forget_long_lost(self, now_ns: int) -> list[NodeChanged]:
        """Forget the members that have been lost for too long, and note when the next one will be."""
        if now_ns < self._forget_ns:
            return []
        lost = [member for member in self.members.values() if member.lost]
        over = [member for member in lost if now_ns - member.last_heard_ns >= FORGET_LOST_NS]
        self._forget_ns = min(
            (m.last_heard_ns + FORGET_LOST_NS for m in lost if m not in over),
            default=now_ns + FORGET_LOST_NS,
        )
        return [self.forget(member) for member in over]

    def mark_silent_lost(self, now_ns: int) -> list[NodeChanged]:
        """Count silent members as lost, and note when the next one could be.

        One that has never said more than hello is forgotten.
        """
        if now_ns < self._silence_ns:
            return []
        lost: list[NodeChanged] = []
        self._silence_ns = now_ns + CLIENT_SILENT_NS
        for member in tuple(self.members.values()):
            if member.lost:
                continue
            # A relay that is here would say if it were lost.
            above = takewhile(lambda relay: not relay.lost, relays_above(member, self.members))
            heard_ns = max([member.last_heard_ns, *(relay.last_heard_ns for relay in above)])
            if now_ns - heard_ns >= CLIENT_SILENT_NS:
                event = self.mark_lost(member, f"silent for {CLIENT_SILENT_NS // 10**9} s")
                lost.append(event if member.is_confirmed else self.forget(member))
            else:
                self._silence_ns = min(self._silence_ns, heard_ns + CLIENT_SILENT_NS)
        return lost

    def next_timer(self) -> int | None:
        """Leader time in ns at which a member could have been silent or lost for too long, None for never."""
        if self.present_count:
            return min(self._silence_ns, self._forget_ns)
        return self._forget_ns if self.members else None

    def cameras(self, *, even_unconfirmed: bool = False) -> list[Member]:
        """Return those that are here and have a camera, by name.

        One that has said no more than hello may not be where it says it is: it takes no part in bursts.
        """
        return [
            member
            for _, member in sorted(self.members.items())
            if not member.lost
            and member.camera.kind not in WITHOUT_CAMERA
            and (member.is_confirmed or even_unconfirmed)
        ]

    def _count(self, member: Member, change: int) -> None:
        if not member.lost:
            self.present_count += change
            self.pollers += change if member.via is None else 0

    def _free_number(self) -> int:
        while True:
            number = self._rng.getrandbits(32)
            if number != PROBE_NUMBER and number not in self._by_number:
                return number
