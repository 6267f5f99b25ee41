"""A node that keeps the root's time by following one of several leaders or relays."""

import random
from collections import deque

from capture_app.common.camera_facts import CameraFacts
from capture_app.common.timeouts import LEADER_SILENT_NS
from capture_app.sync.clock.clock_filter import ClockFilter
from capture_app.sync.engine import Address
from capture_app.sync.rig.failover import LeaderChoice, answers_probe
from capture_app.sync.rig.time_client import TimeClient
from capture_app.sync.timekeeping.poll_schedule import TreeSchedule
from capture_app.sync.timekeeping.timekeeper import Timekeeper
from capture_app.sync.wire.codec import Message, WireError, encode
from capture_app.sync.wire.messages import CLOCK, ControlMessage, Goodbye, Welcome

WINDOW_NS, LONGEST_NS = 60_000_000_000, 300_000_000_000
"""Its clock looks back so far: further than a camera's, as it asks more rarely."""


HEARTBEAT_EVERY_NS = 1_000_000_000
"""Its requests for the time show, too, that it and its parent are there."""


class TreeMember:
    """Keeps the time of a tree's root; `now_ns` is always the node's own clock.

    When its parent falls silent it asks the next one (failover), and keeps its time map meanwhile (holdover).
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

        A parent that has said nothing for `silent_ns` is gone.
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
        """Its membership and its clock."""
        self._choice = LeaderChoice(parents, self.time)
        self._better: Address | None = None
        """A preferred parent that was asked to join while the present one is still followed."""
        self._outbox: deque[tuple[ControlMessage, Address]] = deque()

    @property
    def parent(self) -> Address:
        """The parent that is followed, or asked to join at present."""
        return self._choice.leader

    # In

    def receive_datagram(self, data: bytes, address: Address, now_ns: int) -> None:
        """Take in a datagram that arrived at `now_ns`."""
        if address in self.parents:
            message = self.time.decode(data)
            if message is not None:
                self.receive_message(message, address, now_ns)

    def receive_message(self, message: Message, address: Address, now_ns: int) -> None:
        """Take in a message of one of the parents that arrived at `now_ns`.

        Preferred parents answer probes, and may take this node in, while the present one is followed.
        """
        if address == self.parent:
            self.time.receive_message(message, now_ns)
            self._choice.update(now_ns)
        elif answers_probe(message):
            self._choice.note_answer(address)
        elif isinstance(message, Welcome) and address == self._better:
            self._go_back(address, message, now_ns)

    def note_unreadable(self, error: WireError, address: Address) -> None:
        """Note that one of the parents sent what is no message of this version."""
        if address == self.parent:
            self.time.note_unreadable(error)

    def handle_timer(self, now_ns: int) -> None:
        """Do what is due; call it at `next_timer`, or any time."""
        self.time.handle_timer(now_ns)
        self._choice.update(now_ns)
        better = self._choice.probe_if_due(now_ns)
        if better is not None:
            self._better = better
            self._outbox.append((self.time.hello(), better))

    # Out

    def next_timer(self) -> int:
        """Local time in ns at which `handle_timer` wants to be called."""
        return min(self.time.next_timer(), self._choice.due_ns)

    def datagrams_to_send(self, now_ns: int) -> list[tuple[bytes, Address]]:
        """Return datagrams and where to; a time request carries `now_ns`, so send them at once."""
        datagrams = [(data, self.parent) for data in self.time.datagrams_to_send(now_ns)]
        while self._outbox:
            message, address = self._outbox.popleft()
            datagrams.append((encode(message), address))
        return datagrams + self._choice.datagrams_to_send()

    def leave(self) -> None:
        """Say goodbye and drop the time map: this node is about to stop."""
        self.time.leave()
        self.time.timekeeper.forget()

    # The parts

    def _go_back(self, address: Address, welcome: Welcome, now_ns: int) -> None:
        """Follow a preferred parent that is there again; the time map is kept until that one's is better."""
        number, former = self.time.number, self.parent
        if number is None or welcome.instance != self.time.instance:
            return
        self._better = None
        if self.time.follow(welcome, now_ns):
            self._outbox.append((Goodbye(number), former))
            self._choice.change_to(address, now_ns)
