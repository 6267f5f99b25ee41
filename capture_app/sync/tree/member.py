"""Node that keeps the root's time by following one of several leaders or relays."""

import random

from capture_app.common.camera_facts import CameraFacts
from capture_app.common.timeouts import LEADER_SILENT_NS
from capture_app.sync.clock.clock_filter import ClockFilter
from capture_app.sync.rig.failover import LeaderChoice
from capture_app.sync.rig.time_client import TimeClient
from capture_app.sync.sync_engine import Address
from capture_app.sync.timekeeping.poll_schedule import TreeSchedule
from capture_app.sync.timekeeping.timekeeper import Timekeeper
from capture_app.sync.wire.codec import Message, WireError, encode
from capture_app.sync.wire.datagrams import CLOCK, Goodbye, Welcome

WINDOW_NS, LONGEST_NS = 60_000_000_000, 300_000_000_000
"""Window of its clock filter: longer than a camera's, as its requests are rarer."""


HEARTBEAT_EVERY_NS = 1_000_000_000
"""Heartbeat interval; time requests also show that the node and its parent are alive."""


class TreeMember(LeaderChoice):
    """Member of a tree that keeps the root's time; `now_ns` is always the node's own clock.

    When its parent falls silent it asks the next one (failover), and meanwhile keeps its time map (holdover).
    It joins a preferred one before it leaves the present one.
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
        time = TimeClient(
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
        super().__init__(parents, time)
        self._better: Address | None = None
        """Preferred parent that was asked to join while the present one is still followed."""

    def receive_message(self, message: Message, address: Address, now_ns: int) -> None:
        """Process a message from one of the parents that arrived at `now_ns`.

        While the present parent is followed, preferred ones answer probes and may admit this node.
        """
        if isinstance(message, Welcome) and address == self._better and address != self.leader:
            self._go_back(address, message, now_ns)
        else:
            super().receive_message(message, address, now_ns)

    def note_unreadable(self, error: WireError, address: Address) -> None:
        """Record that the present parent sent a datagram that is not a message of this version."""
        if address == self.leader:
            self.time.note_unreadable(error)

    def try_to_join(self, better: Address, now_ns: int) -> None:
        """Ask a preferred parent to admit this node."""
        self._better = better
        self._outbox.append((encode(self.time.hello()), better))

    def leave(self) -> None:
        """Send a goodbye and discard the time map before this node stops."""
        self.time.leave()
        self.time.timekeeper.forget()

    def _go_back(self, address: Address, welcome: Welcome, now_ns: int) -> None:
        """Return to a preferred parent; the present time map stays in use until the new one is better."""
        number, former = self.time.number, self.leader
        if number is None or welcome.instance != self.time.instance:
            return
        self._better = None
        if self.time.follow(welcome, now_ns):
            self._outbox.append((encode(Goodbye(number)), former))
            self.change_to(address, now_ns)
