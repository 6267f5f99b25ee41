"""Relay: a member of its parent, and a leader of its own clients, which keep the root's time through it.

A relay's time replies carry its own clock, which never jumps when its estimate changes. Its configuration
carries the map from that clock to the root's, with its uncertainty. Each client chains the two maps.
"""

import random
from dataclasses import replace

import msgspec

from capture_app.common.node_state import RELAY
from capture_app.sync.phase.frame_grid import FrameGrid
from capture_app.sync.phase.grid_phase_choice import GridPhaseChoice
from capture_app.sync.rig.events import LeaderEvent
from capture_app.sync.rig.leader_engine import Leader, LeaderConfig
from capture_app.sync.rig.relay_summary import RelaySummary
from capture_app.sync.rig.time_client import TimeClientEvent
from capture_app.sync.sync_engine import Address
from capture_app.sync.tree.member import TreeMember
from capture_app.sync.wire.codec import FromClient, Message, WireError, decode
from capture_app.sync.wire.datagrams import (
    CLOCK,
    PROBE_NUMBER,
    Heartbeat,
    Hello,
    JoinRefusal,
    Notice,
    Principal,
    Trigger,
    UnknownMember,
    Welcome,
    upstream_map,
)

OF_CAMERAS = msgspec.structs.replace(CLOCK, kind=RELAY, model="relay")
"""Description of a camera relay: a member whose loss must be noticed within seconds."""


class Relay:
    """Member and leader behind one socket; `now_ns` is the relay's own clock.

    Clients can join once the root's time is known. A relay that loses its parent goes into holdover, also
    for clients that join then. Bursts resume with a new parent.
    """

    def __init__(self, member: TreeMember, leader: LeaderConfig, rng: random.Random) -> None:
        self.member = member
        self.summary = RelaySummary(member.time.name)
        self.leader = Leader(replace(leader, instance=member.time.instance), rng, self.summary)
        self._number: int | None = None

    def receive_datagram(
        self, data: bytes, address: Address, now_ns: int, principal: Principal | None = None
    ) -> None:
        """Process a datagram from a parent or a client that arrived at `now_ns`.

        `principal` is the client that sealed it; None in a rig without seals, or if a parent sealed it.
        """
        try:
            message = decode(data)
        except WireError as error:
            if address in self.member.leaders:
                self.member.note_unreadable(error, address)
            else:
                self.leader.report_version(data, address, now_ns)
            return
        # One address may be both a parent's and a client's: the kind of message distinguishes them.
        if not isinstance(message, FromClient):
            if principal is not None:
                self.leader.impostures += 1
            elif address == self.member.leader:
                self._receive_from_parent(message, address, now_ns)
            elif address in self.member.leaders:
                self.member.receive_message(message, address, now_ns)
            self._update_terms()
        elif (
            isinstance(message, Heartbeat)
            and message.client == PROBE_NUMBER
            and self.leader.current.in_holdover
        ):
            pass  # A client probes for a better leader than its own, which this relay in holdover is not.
        elif self.leader.current.upstream is not None:
            self.leader.receive_message(message, address, now_ns, principal)
        elif isinstance(message, Hello) and self.member.time.is_member:
            self.leader.refuse(message, "the relay does not know the time yet", address, retry_here=True)

    def handle_timer(self, now_ns: int) -> None:
        """Run the actions that are due; call it at `next_timer`, or at any time."""
        self.member.handle_timer(now_ns)
        self._update_terms()
        self.leader.handle_timer(now_ns)
        self.summary.handle_timer(now_ns)

    def leave(self) -> None:
        """Send a goodbye to the parent and release the clients before this relay stops."""
        self.member.leave()
        self.leader.leave()

    def next_timer(self) -> int:
        """Return the local time in ns at which `handle_timer` is to be called."""
        return min(self.member.next_timer(), self.summary.next_timer(), self.leader.next_timer())

    def datagrams_to_send(self, now_ns: int) -> list[tuple[bytes, Address]]:
        """Return datagrams with their destinations; time messages carry `now_ns`, so send them at once."""
        return self.leader.datagrams_to_send(now_ns) + self.datagrams_to_parents(now_ns)

    def datagrams_to_parents(self, now_ns: int) -> list[tuple[bytes, Address]]:
        """Return the datagrams for parents only; the others in `datagrams_to_send` are the leader's."""
        of_members = [(data, self.member.leader) for data in self.summary.datagrams_to_send()]
        return self.member.datagrams_to_send(now_ns) + of_members

    def next_event(self) -> TimeClientEvent | LeaderEvent | None:
        """Return the next event of the member or the leader; None if there is none."""
        return self.member.time.next_event() or self.leader.next_event()

    # The parts

    def _receive_from_parent(self, message: Message, address: Address, now_ns: int) -> None:
        """Process a message for this relay itself, or for one of its members."""
        summary, members = self.summary, self.leader.roster.members
        match message:
            case Welcome() if message.instance != self.member.time.instance:
                if usurper := summary.note_welcome(message.instance, message.client, members):
                    # The root decides who owns a name, and another member used it here.
                    self.leader.evict(usurper)
            case JoinRefusal() if message.instance != self.member.time.instance:
                if refused := summary.note_refusal(message.instance, message.reason, members):
                    self.leader.drop_member(refused, message.reason)
            case UnknownMember() if message.client != self.member.time.number:
                summary.note_unknown(message.client)
            case Trigger():
                below = [summary.member(number) for number in (message.client, *message.others)]
                self.leader.send_trigger((member for member in below if member is not None), message)
            case Notice() if member := summary.member(message.client):
                self.leader.send(member, msgspec.structs.replace(message, client=member.number))
            case _:
                self.member.receive_message(message, address, now_ns)

    def _update_terms(self) -> None:
        """Adopt the parent's configuration and the map to the root's clock."""
        member, leader = self.member, self.leader
        current, above, number = leader.current, member.time.followed, member.time.number
        if number != self._number:
            self._number = number
            self.summary.restart(has_parent=number is not None)
        current.continues = None if above is None else above.continues
        in_holdover = number is None or above is None or above.in_holdover
        if current.in_holdover is not in_holdover:
            current.in_holdover = in_holdover
            if current.grid_choice is not None:
                leader.acknowledge_all()
        if member.time.time_map is None:
            # This clock has jumped, or the root is another one: the map that clients have is wrong now.
            current.upstream = None
            return
        if above is None or above.path[0] != member.time.timekeeper.path[0]:
            # Another root's grid means nothing before its time is known.
            return
        path, epoch_ns = member.time.timekeeper.path, member.time.time_map.epoch_local_ns
        known_map = current.upstream
        if known_map is None or (known_map.path, known_map.epoch_local_ns) != (path, epoch_ns):
            current.upstream = upstream_map(path, member.time.time_map)
        grid = FrameGrid(above.anchor_leader_ns, above.period_ns)
        moved = (leader.grid, current.config.align_row) != (grid, above.align_row)
        if current.grid_choice is None or moved:
            current.grid_choice = GridPhaseChoice(grid)
        # Without a parent no stream is restarted, because the choice for the other cameras is unknown.
        current.grid_choice.common_instant_leader_ns = (
            above.common_instant_leader_ns if number is not None else None
        )
        current.config = replace(current.config, align_row=above.align_row)
        moved |= current.delays_ns != above.delays_ns
        current.delays_ns = above.delays_ns
        if moved:
            leader.acknowledge_all()
