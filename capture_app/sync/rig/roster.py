"""Members of a leader: their numbers and slots, and the detection of silent ones."""

import random
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import takewhile

from msgspec import structs

from capture_app.common.bounds import MAX_TEXT
from capture_app.common.camera_facts import CameraFacts, PhaseControl
from capture_app.common.names import find_alike
from capture_app.common.node_state import WITHOUT_CAMERA, NodeState
from capture_app.common.timeouts import (
    CLIENT_SILENT_NS,
    CLIENT_UNREPORTED_NS,
    FORGET_LOST_NS,
    UNREPORTED_PER_CLIENT_NS,
)
from capture_app.sync.phase.grid_phase_choice import WEIGHTS, CameraPhase
from capture_app.sync.rig.events import NodeChanged
from capture_app.sync.sync_engine import Address
from capture_app.sync.timekeeping.poll_schedule import NEVER_NS
from capture_app.sync.wire.datagrams import (
    MAX_DEPTH,
    MAX_PERIOD_NS,
    MIN_PERIOD_NS,
    PROBE_NUMBER,
    Hello,
    Principal,
    Report,
)

MAX_CLIENTS = 32_000
"""Maximum number of a leader's clients; the largest simulated rig has 20,000 nodes."""
MAX_CAMERAS_PER_MACHINE = 100
"""Maximum number of names per machine, so that one machine cannot exhaust the roster."""
LEFT = "it left"
"""Reason of a member that has signed off, and is not missed."""
MAX_BELOW_RELAY = 1000
"""Maximum number of clients that one paired relay introduces."""


@dataclass(slots=True)
class Member:
    """A client that has joined, present or lost."""

    name: str
    instance: int
    number: int
    address: Address
    camera: CameraFacts
    report: Report
    last_heard_ns: int
    slot: float
    via: str | None = None
    """Name of the relay that it joined and that speaks for it; None if it joined this leader directly."""
    lost: str = ""
    """Reason why it counts as lost; empty while it is present."""
    took_before: bool = False
    """Whether its camera had taken frames before it joined again."""
    is_confirmed: bool = False
    """Whether it has used its assigned number, which proves that it receives at its address."""
    principal: Principal | None = None
    """Machine that seals its messages; None in a rig without seals."""
    pin: str = ""
    """Pin of its own machine, even if a relay seals for it."""

    @property
    def has_taken(self) -> bool:
        """Whether its camera has taken a frame, now or before it joined again."""
        return self.took_before or self.report.frames > 0

    @property
    def is_unknown(self) -> bool:
        """Whether it has sent only hellos."""
        return not (self.is_confirmed or self.has_taken)

    @property
    def machine(self) -> str:
        """Machine that votes for it, by its pin; on an open rig each member counts as a machine."""
        return self.pin or self.name

    def is_of_another_machine(self, hello: Hello) -> bool:
        """Whether a hello comes from another machine than this member's."""
        return self.pin not in ("", hello.pin)


def camera_phases(members: Iterable[Member]) -> list[CameraPhase]:
    """Return the reported phases of the members that are present."""
    return [
        CameraPhase(
            member.name,
            member.camera.phase_control,
            member.report.frame_leader_ns,
            member.report.drift_ppm or 0.0,
            max(1, member.report.tolerance_ns),
            member.machine,
        )
        for member in members
        if not member.lost
    ]


def relays_above(member: Member, members: Mapping[str, Member]) -> Iterator[Member]:
    """Yield the known relays between a member and this leader, nearest to the member first."""
    above = members.get(member.via or "")
    for _ in range(MAX_DEPTH):
        if above is None:
            return
        yield above
        above = members.get(above.via or "")


def van_der_corput(index: int) -> float:
    """Return the van der Corput number of an index, in 0 to 1 (van der Corput 1935).

    Consecutive indices give numbers far apart.
    """
    part, step = 0.0, 0.5
    while index:
        part += step * (index & 1)
        index, step = index >> 1, step / 2.0
    return part


class Roster:
    """All members by name; lost ones stay for FORGET_LOST_NS, so that they can return."""

    def __init__(self, rng: random.Random, owners: dict[str, str] | None = None) -> None:
        self.members: dict[str, Member] = {}
        self.owners = {} if owners is None else owners
        """Pin of the machine that owns each name ever used. A relay asks its parent instead, and has none."""
        self.direct_pins: frozenset[str] = frozenset()
        """Pins of the machines that are paired as cameras here, for which no relay may speak."""
        self.own_pin = ""
        """Pin of this machine, for which only a relay of its own may speak."""
        self.immovable: dict[str, Member] = {}
        """Members whose streams cannot be moved to every grid: the grid is moved to suit them."""
        self.present_count = 0
        """Number of members that are not lost."""
        self.pollers = 0
        """Number of present members that send time requests to this leader instead of a relay."""
        self._rng = rng
        self._by_number: dict[int, Member] = {}
        self._unconfirmed: dict[str, Member] = {}
        """Members that have sent only hellos, oldest first."""
        self._joins = 0
        self._silence_ns = self._forget_ns = 0
        """Earliest times at which a member can have been silent, or lost, for too long."""

    def by_name(self) -> tuple[Member, ...]:
        """Return all members by name, including lost ones, whose reports have the state LOST."""
        return tuple(member for _, member in sorted(self.members.items()))

    def title(self, name: str) -> str:
        """Return what people call the member of that name; the name if there is none."""
        return self.members[name].camera.called(name) if name in self.members else name

    def member_by_number(self, number: int) -> Member | None:
        """Return the present member with that number, or None."""
        member = self._by_number.get(number)
        return None if member is None or member.lost else member

    def is_of_another_machine(self, hello: Hello) -> bool:
        """Whether the name that a client requests belongs to another machine."""
        member = self.members.get(hello.name)
        is_members = member is not None and member.is_of_another_machine(hello)
        return is_members or self.owners.get(hello.name, hello.pin) != hello.pin

    def refusal(self, hello: Hello) -> str:
        """Return the reason why a client cannot join; empty if it can."""
        known, title = self.members.get(hello.name), hello.camera.called(hello.name)
        if self.is_of_another_machine(hello):
            return (
                f"two machines are called {hello.name}: give this one another --name; or, when the other is"
                f" off for good, on the leader: capture-app cameras remove {hello.name}"
            )[:MAX_TEXT]
        here = known is not None and not known.lost and known.instance != hello.instance
        namesake = hello.name if here else None if known else find_alike(hello.name, self.members)
        if namesake is not None and (other := self.title(namesake)) == title:
            return f"another camera named {title} is here: give this one another --name"
        if namesake is not None:
            return f"{other} is here, and {title} would be the same folder: give this one another --name"
        if hello.via is not None and hello.pin in self.direct_pins:
            return (
                "its machine is paired with the leader, and no relay may speak for it: join the leader,"
                " or there: capture-app trust remove NAME"
            )
        if known is None and self._is_full(hello.pin) and self._first_to_drop(hello.pin) is None:
            return f"its machine has {MAX_CAMERAS_PER_MACHINE} cameras here already"
        if known is None and len(self.members) >= MAX_CLIENTS and self._first_to_drop() is None:
            return "the rig is full"
        if not MIN_PERIOD_NS <= hello.camera.period_ns <= MAX_PERIOD_NS:
            return f"a frame period of {hello.camera.period_ns} ns is not possible"
        return ""

    def refusal_below(self, relay: Principal, hello: Hello) -> str:
        """Return the reason why a relay may not introduce a client; empty if it may."""
        if hello.pin and hello.pin == self.own_pin != relay.pin:
            return "its pin is the leader's own, and no other machine may speak for it"
        if hello.name in self.members:
            return ""
        below = sum(member.principal == relay and member.via is not None for member in self.members.values())
        return f"its relay has {MAX_BELOW_RELAY} nodes already" if below >= MAX_BELOW_RELAY else ""

    def claim(self, hello: Hello) -> None:
        """Record a hello's machine as the owner of its name; release that machine's oldest excess names."""
        if self.owners.get(hello.name) != hello.pin:
            self.owners[hello.name] = hello.pin
            lost = [
                name for name, pin in self.owners.items() if pin == hello.pin and name not in self.members
            ]
            for name in lost[:-MAX_CAMERAS_PER_MACHINE]:
                del self.owners[name]

    def confirm(self, member: Member) -> bool:
        """Note that a member has used its assigned number; return whether this is the first time."""
        first, member.is_confirmed = not member.is_confirmed, True
        self._unconfirmed.pop(member.name, None)
        return first

    def make_room(self, hello: Hello) -> list[NodeChanged]:
        """Remove a dispensable member if an accepted new client would exceed a limit."""
        if hello.name in self.members:
            return []
        forgotten: list[NodeChanged] = []
        for pin in (hello.pin, ""):
            full = self._is_full(pin) if pin else len(self.members) >= MAX_CLIENTS
            if full and (member := self._first_to_drop(pin)) is not None:
                forgotten.append(self.forget(member))
        return forgotten

    def _is_full(self, pin: str) -> bool:
        return (
            bool(pin)
            and sum(member.pin == pin for member in self.members.values()) >= MAX_CAMERAS_PER_MACHINE
        )

    def _first_to_drop(self, pin: str = "") -> Member | None:
        """Return a member that has sent only hellos, or else the member lost the longest.

        With `pin`, only members of that machine are considered.
        """
        unconfirmed = (member for member in self._unconfirmed.values() if pin in ("", member.pin))
        lost = (member for member in self.members.values() if member.lost and pin in ("", member.pin))
        return next(unconfirmed, None) or min(lost, key=lambda member: member.last_heard_ns, default=None)

    def admit(
        self, hello: Hello, address: Address, now_ns: int, principal: Principal | None = None
    ) -> tuple[Member, NodeChanged | None]:
        """Add an accepted client; return no event if it is already present and merely repeats its hello."""
        known = self.members.get(hello.name)
        moved = known is not None and not known.lost
        if known is not None:
            if not known.lost and known.via == hello.via:
                known.last_heard_ns, known.principal = now_ns, principal
                # Its exposure may have changed, and its timestamp accuracy may be known better.
                known.camera = structs.replace(
                    known.camera, stamp=hello.camera.stamp, exposure_ns=hello.camera.exposure_ns
                )
                return known, None
            # A relay that it has left still uses the old number, and is answered that it is unknown.
            self._by_number.pop(known.number, None)
            self._count(known, -1)
        number = self._free_number()
        member = Member(
            name=hello.name,
            instance=hello.instance,
            number=number,
            address=address,
            camera=hello.camera,
            report=Report(state=NodeState.JOINING),
            last_heard_ns=now_ns,
            slot=van_der_corput(self._joins),
            via=hello.via,
            took_before=known is not None and known.has_taken,
            principal=principal,
            pin=hello.pin,
        )
        self._joins += 1
        self._count(member, 1)
        self._silence_ns = min(self._silence_ns, now_ns + CLIENT_SILENT_NS)
        self.members[hello.name] = self._by_number[number] = member
        self._unconfirmed.pop(hello.name, None)
        if known is not None and known.instance == hello.instance and known.is_confirmed:
            # It has moved or returned: no other machine knows its instance number.
            member.is_confirmed = True
        else:
            self._unconfirmed[hello.name] = member
        self.immovable.pop(hello.name, None)
        if hello.camera.phase_control in WEIGHTS and hello.camera.kind not in WITHOUT_CAMERA:
            self.immovable[hello.name] = member
        change = NodeChanged(hello.name, "joined" if known is None else "returned")
        return member, NodeChanged(hello.name, "moved", where=hello.via or "") if moved else change

    def mark_lost(self, member: Member, reason: str) -> NodeChanged:
        """Mark a member as lost; its frame counts remain."""
        self._count(member, -1)
        member.lost = reason
        member.report = Report(
            state=NodeState.LOST, message=reason, frames=member.report.frames, drops=member.report.drops
        )
        self._forget_ns = min(self._forget_ns, member.last_heard_ns + FORGET_LOST_NS)
        return NodeChanged(member.name, "lost", reason)

    def forget(self, member: Member) -> NodeChanged:
        """Remove a member from the roster; the owner of its name remains."""
        self._count(member, -1)
        self._by_number.pop(member.number, None)
        self._unconfirmed.pop(member.name, None)
        self.immovable.pop(member.name, None)
        del self.members[member.name]
        return NodeChanged(member.name, "forgotten")

    def forget_long_lost(self, now_ns: int) -> list[NodeChanged]:
        """Remove members that have been lost for too long, and schedule the next check."""
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
        """Mark silent members as lost, and schedule the next check.

        A member that has sent only hellos is removed instead.
        """
        if now_ns < self._silence_ns:
            return []
        lost: list[NodeChanged] = []
        self._silence_ns = now_ns + CLIENT_SILENT_NS
        unreported_ns = CLIENT_UNREPORTED_NS + self.present_count * UNREPORTED_PER_CLIENT_NS
        for member in tuple(self.members.values()):
            if member.lost:
                continue
            # A relay that is present reports the loss of its member, unless the answer to its hello was lost.
            above = takewhile(lambda relay: not relay.lost, relays_above(member, self.members))
            heard_ns = max([member.last_heard_ns, *(relay.last_heard_ns for relay in above)])
            silent_ns = min(heard_ns + CLIENT_SILENT_NS, member.last_heard_ns + unreported_ns)
            if now_ns >= silent_ns:
                event = self.mark_lost(member, f"silent for {(silent_ns - member.last_heard_ns) // 10**9} s")
                lost.append(self.forget(member) if member.is_unknown else event)
            else:
                self._silence_ns = min(self._silence_ns, silent_ns)
        return lost

    def next_timer(self) -> int:
        """Leader time in ns at which a member could have been silent or lost for too long."""
        if self.present_count:
            return min(self._silence_ns, self._forget_ns)
        return self._forget_ns if self.members else NEVER_NS

    def cameras(self, *, even_unconfirmed: bool = False) -> list[Member]:
        """Return the present members that have a camera, by name.

        An unconfirmed member's address may be forged, so it takes no part in bursts.
        """
        return [
            member
            for _, member in sorted(self.members.items())
            if not member.lost
            and member.camera.kind not in WITHOUT_CAMERA
            and (member.is_confirmed or even_unconfirmed)
        ]

    def is_ready(self) -> bool | None:
        """Whether movable cameras of two machines are aligned; None: no two machines have such cameras."""
        movable: set[str] = set()
        aligned: set[str] = set()
        for member in self.members.values():
            if member.lost or member.camera.phase_control is PhaseControl.NONE:
                continue
            movable.add(member.machine)
            if member.report.state.is_aligned:
                aligned.add(member.machine)
                if len(aligned) == 2:
                    return True
        return False if len(movable) > 1 else None

    def _count(self, member: Member, change: int) -> None:
        if not member.lost:
            self.present_count += change
            self.pollers += change if member.via is None else 0

    def _free_number(self) -> int:
        while (number := self._rng.getrandbits(32)) == PROBE_NUMBER or number in self._by_number:
            pass
        return number
