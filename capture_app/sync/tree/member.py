"""Node that keeps the root's time by following one of several leaders or relays."""

import random
from collections import deque

from capture_app.common.camera_facts import CameraFacts
from capture_app.common.timeouts import LEADER_SILENT_NS
from capture_app.sync.clock.clock_filter import ClockFilter
from capture_app.sync.rig.failover import LeaderChoice, answers_probe
from capture_app.sync.rig.time_client import TimeClient
from capture_app.sync.sync_engine import Address
from capture_app.sync.timekeeping.poll_schedule import TreeSchedule
from capture_app.sync.timekeeping.timekeeper import Timekeeper
from capture_app.sync.wire.codec import Message, WireError, encode
from capture_app.sync.wire.datagrams import CLOCK, ControlMessage, Goodbye, Welcome

WINDOW_NS, LONGEST_NS = 60_000_000_000, 300_000_000_000
"""Window of its clock filter: longer than a camera's, as its requests are rarer."""


HEARTBEAT_EVERY_NS = 1_000_000_000
"""Heartbeat interval; time requests also show that the node and its parent are alive."""


class TreeMember:
    """Member of a tree that keeps the root's time; `now_ns` is always the node's own clock.

    When its parent falls silent it asks the next one (failover), and meanwhile keeps its time map (holdover).
    """

    def __init__(
        self,
        name: str,
        instance: int,
        parents: tuple[Address, ...],
        rng: random.Random,
        camera: CameraFacts = CLOCK,
        *,
        heartbeat_every_ns: int = HEARTBEAT_EVERY_NS,
        silent_ns: int = LEADER_SILENT_NS,
    ) -> None:
        """`parents` are asked in turn, the best one first; `camera` describes this node to them.

        A parent that is silent for `silent_ns` counts as lost.
        """
        self.parents = parents
        self.time = TimeClient(
            name,
            instance,
            Timekeeper(
                rng.getrandbits(32),
                TreeSchedule(),
                clock=ClockFilter(window_ns=WINDOW_NS, longest_ns=LONGEST_NS),
            ),
            camera,
            heartbeat_every_ns=heartbeat_every_ns,
            silent_ns=silent_ns,
        )
        """Membership and clock of this node."""
        self._choice = LeaderChoice(parents, self.time)
        self._better: Address | None = None
        """Preferred parent that was asked to join while the present one is still followed."""
        self._outbox: deque[tuple[ControlMessage, Address]] = deque()

    @property
    def parent(self) -> Address:
        """Address of the parent that is followed, or presently asked to join."""
        return self._choice.leader

    # In

    def receive_datagram(self, data: bytes, address: Address, now_ns: int) -> None:
        """Process a datagram that arrived at `now_ns`."""
        if address in self.parents and (message := self.time.decode(data)) is not None:
            self.receive_message(message, address, now_ns)

    def receive_message(self, message: Message, address: Address, now_ns: int) -> None:
        """Process a message from one of the parents that arrived at `now_ns`.

        While the present parent is followed, preferred ones answer probes and may admit this node.
        """
        if address == self.parent:
            self.time.receive_message(message, now_ns)
            self._choice.update(now_ns)
        elif answers_probe(message):
            self._choice.note_answer(address)
        elif isinstance(message, Welcome) and address == self._better:
            self._go_back(address, message, now_ns)

    def note_unreadable(self, error: WireError, address: Address) -> None:
        """Record that the present parent sent a datagram that is not a message of this version."""
        if address == self.parent:
            self.time.note_unreadable(error)

    def handle_timer(self, now_ns: int) -> None:
        """Run the actions that are due; call it at `next_timer`, or at any time."""
        self.time.handle_timer(now_ns)
        self._choice.update(now_ns)
        if (better := self._choice.probe_if_due(now_ns)) is not None:
            self._better = better
            self._outbox.append((self.time.hello(), better))

    # Out

    def next_timer(self) -> int:
        """Return the local time in ns at which `handle_timer` is to be called."""
        return min(self.time.next_timer(), self._choice.due_ns)

    def datagrams_to_send(self, now_ns: int) -> list[tuple[bytes, Address]]:
        """Return datagrams with their destinations; a time request carries `now_ns`, so send them at once."""
        datagrams = [(data, self.parent) for data in self.time.datagrams_to_send(now_ns)]
        while self._outbox:
            message, address = self._outbox.popleft()
            datagrams.append((encode(message), address))
        return datagrams + self._choice.datagrams_to_send()

    def leave(self) -> None:
        """Send a goodbye and discard the time map before this node stops."""
        self.time.leave()
        self.time.timekeeper.forget()

    # The parts

    def _go_back(self, address: Address, welcome: Welcome, now_ns: int) -> None:
        """Return to a preferred parent; the present time map stays in use until the new one is better."""
        number, former = self.time.number, self.parent
        if number is None or welcome.instance != self.time.instance:
            return
        self._better = None
        if self.time.follow(welcome, now_ns):
            self._outbox.append((Goodbye(number), former))
            self._choice.change_to(address, now_ns)
