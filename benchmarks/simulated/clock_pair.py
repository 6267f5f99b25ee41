"""A node and its leader in virtual time: the engine's own messages, on clocks and ways that change."""

import random
from collections.abc import Callable
from dataclasses import dataclass

from benchmarks.simulated.changing_clocks import ChangingClock
from benchmarks.simulated.links import DelayLaw, Direction, Link
from benchmarks.simulated.virtual_rig import Timer, VirtualTime
from capture_app.common.node_state import NodeState
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.rig.leader_engine import Leader, LeaderConfig
from capture_app.sync.rig.rig_config import RequestedConfig
from capture_app.sync.rig.time_client import TimeClient, TimeClientEvent
from capture_app.sync.timekeeping.poll_schedule import AccuracyTarget
from capture_app.sync.timekeeping.timekeeper import Timekeeper

ADDRESS = ("node", 0)
START_TRUE_NS = 10**12


@dataclass(frozen=True, slots=True)
class LongerFrom:
    """A law of delays that are longer by so much from a true time on; in ns."""

    law: DelayLaw
    from_true_ns: int
    extra_ns: int

    def draw(self, rng: random.Random, true_ns: int = 0) -> int:
        """Return the delay of one datagram, in ns."""
        return self.law.draw(rng, true_ns) + (self.extra_ns if true_ns >= self.from_true_ns else 0)


class ClockPair:
    """The two engines; the pictures of the node are to be within a tolerance."""

    def __init__(
        self,
        link: Link,
        node: ChangingClock,
        leader: ChangingClock,
        rng: random.Random,
        tolerance_ns: int | None,
        silent_from_true_ns: int | None = None,
    ) -> None:
        """`node` and `leader` are their clocks; both start at START_TRUE_NS.

        Nothing passes any more from `silent_from_true_ns` on.
        """
        keeper = Timekeeper(rng.getrandbits(32), target=AccuracyTarget(tolerance_ns))
        self.node = TimeClient("node", rng.getrandbits(32), keeper)
        self.events: list[TimeClientEvent] = []
        self._leader = Leader(LeaderConfig(1, 0, RequestedConfig(period_ns=33_333_333)), rng)
        self._clock, self._leader_clock = node, leader
        self._rng, self._channel, self._silent_from_ns = rng, link.open(), silent_from_true_ns
        self._time = VirtualTime()
        self._time.now_true_ns = START_TRUE_NS
        self._timer = Timer(self._time, self._pump)
        self._pump()

    def run_until(self, since_start_ns: int) -> None:
        """Let time pass until so long after the start, in ns."""
        self._time.run_until(START_TRUE_NS + since_start_ns)

    @property
    def is_ready(self) -> bool:
        """Whether a camera's node with this clock would be ready, and not coarse."""
        return self.node.state is NodeState.READY and self.node.timekeeper.target.met

    def judge(self) -> tuple[float, TimeMap, int] | None:
        """Return the error in ns now, the map it is of, and the node's time; None while there is no map."""
        time_map, local_ns = self.node.time_map, self._clock.local_from_true(self._time.now_true_ns)
        if time_map is None:
            return None
        leader_ns = self._leader_clock.local_from_true(self._time.now_true_ns)
        return time_map.leader_from_local(local_ns) - leader_ns, time_map, local_ns

    def _pump(self) -> None:
        node, now_ns = self.node, self._clock.local_from_true(self._time.now_true_ns)
        if now_ns >= node.next_timer():
            node.handle_timer(now_ns)
        self._send("to_leader", self._at_leader, node.datagrams_to_send(now_ns))
        while (event := node.next_event()) is not None:
            self.events.append(event)
        self._timer.set(self._clock.true_from_local(node.next_timer()) + 1)

    def _send(self, direction: Direction, arrive: Callable[[bytes], None], datagrams: list[bytes]) -> None:
        true_ns = self._time.now_true_ns
        if self._silent_from_ns is not None and true_ns >= self._silent_from_ns:
            return
        for data in datagrams:
            for delay_ns in self._channel.deliveries(direction, true_ns, self._rng):
                self._time.schedule(true_ns + delay_ns, arrive, data)

    def _at_leader(self, data: bytes) -> None:
        now_ns = self._leader_clock.local_from_true(self._time.now_true_ns)
        due_ns = self._leader.next_timer()
        if due_ns is not None and now_ns >= due_ns:
            self._leader.handle_timer(now_ns)
        self._leader.receive_datagram(data, ADDRESS, now_ns)
        answers = [answer for answer, _ in self._leader.datagrams_to_send(now_ns)]
        self._send("to_client", self._at_node, answers)

    def _at_node(self, data: bytes) -> None:
        self.node.receive_datagram(data, self._clock.local_from_true(self._time.now_true_ns))
        self._pump()
