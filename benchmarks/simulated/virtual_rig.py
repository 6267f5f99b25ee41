"""A rig in virtual time: the engine's own leader and clients, simulated clocks, sensors and links.

Events run in the order of their true time, and nothing waits.
"""

import heapq
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from benchmarks.simulated.links import Channel, Link
from benchmarks.simulated.wireless import WIFI
from capture_app.common.clock import NodeClock
from capture_app.common.node_state import NodeState
from capture_app.common.stagger import Stagger
from capture_app.plugins.cameras.sim.profiles import SensorProfile, facts_of
from capture_app.plugins.cameras.sim.sensor import DELIVERY_NS, Sensor, SensorFrame
from capture_app.sync.phase.actuators import InjectionProfile
from capture_app.sync.phase.estimator import FrameStamp
from capture_app.sync.rig.burst_orders import BurstOrder
from capture_app.sync.rig.client import Client, ClientConfig
from capture_app.sync.rig.events import ClientEvent, LeaderEvent
from capture_app.sync.rig.frame_selection import Burst, FramesSelected
from capture_app.sync.rig.leader_engine import Leader, LeaderConfig
from capture_app.sync.rig.rig_config import RequestedConfig
from capture_app.sync.timekeeping.poll_schedule import AccuracyTarget, SteadySchedule
from capture_app.sync.wire.camera_commands import CameraCommand, InjectFrame, RestartStream, SetFrameDuration


class VirtualTime:
    """The true time of a simulation, and all events scheduled in it.

    Simulated minutes take moments, and the same seed gives the same run. Events at the same instant run in
    the order in which they were scheduled.
    """

    def __init__(self) -> None:
        self.now_true_ns = 0
        self._queue: list[tuple[int, int, Callable[..., object], tuple[Any, ...]]] = []
        self._scheduled = 0

    def schedule(self, true_ns: int, action: Callable[..., object], *arguments: Any) -> None:
        """Schedule `action(*arguments)` at a true time in ns."""
        self._scheduled += 1
        heapq.heappush(self._queue, (true_ns, self._scheduled, action, arguments))

    def run_until(self, end_true_ns: int, done: Callable[[], bool] | None = None) -> bool:
        """Advance to this time, or until `done()` after an action; return whether that became true."""
        queue, pop = self._queue, heapq.heappop
        while queue and queue[0][0] <= end_true_ns:
            self.now_true_ns, _, action, arguments = pop(queue)
            action(*arguments)
            if done is not None and done():
                return True
        self.now_true_ns = end_true_ns
        return done is not None and done()


class Timer:
    """The single timer of an engine; setting it cancels its earlier time."""

    __slots__ = ("_action", "_arguments", "_due_true_ns", "_time")

    def __init__(self, time: VirtualTime, action: Callable[..., object], *arguments: Any) -> None:
        """Create the timer; it calls `action(*arguments)` when due."""
        self._time, self._action, self._arguments = time, action, arguments
        self._due_true_ns = -1

    @property
    def is_pending(self) -> bool:
        """Return whether it is set to a future time."""
        return self._due_true_ns > self._time.now_true_ns

    def set(self, true_ns: int) -> None:
        """Set it to a true time in ns, at the earliest the next nanosecond."""
        true_ns = max(true_ns, self._time.now_true_ns + 1)
        if true_ns != self._due_true_ns:
            self._due_true_ns = true_ns
            self._time.schedule(true_ns, self._ring, true_ns)

    def _ring(self, true_ns: int) -> None:
        if true_ns == self._due_true_ns:
            self._action(*self._arguments)


@dataclass(frozen=True, slots=True)
class NodeSpec:
    """One camera node of a virtual rig."""

    name: str
    profile: SensorProfile
    clock: NodeClock
    link: Link = WIFI
    tolerance_ns: int | None = 60_000
    clock_tolerance_ns: int | None = None
    start_true_ns: int = 0
    injection_profile: InjectionProfile | None = None
    schedule: Callable[[], SteadySchedule] = SteadySchedule
    """Creates the schedule of its time requests."""
    any_clock: bool = False
    """Whether its clock suffices once its schedule calls it synchronized, whatever its uncertainty."""


@dataclass(slots=True)
class VirtualNode:
    """A running node: its engine, its device, and the events so far."""

    spec: NodeSpec
    sensor: Sensor
    client: Client[SensorFrame]
    channel: Channel
    timer: Timer = field(init=False)
    alive: bool = True
    events: list[ClientEvent[SensorFrame]] = field(default_factory=list)
    bursts: dict[int, FramesSelected[SensorFrame]] = field(default_factory=dict)
    """Frames picked for each burst, by its number."""


class VirtualRig:
    """One leader and its clients; the leader's clock is the true time, less what it was suspended."""

    def __init__(
        self,
        specs: Sequence[NodeSpec],
        *,
        seed: int,
        period_ns: int | None = None,
        align_row: float | None = None,
        stagger: Stagger | None = None,
        exchanges_per_s: float | None = None,
    ) -> None:
        """Build the rig; `exchanges_per_s` is as in `LeaderConfig`, the others as in `RequestedConfig`."""
        self.nodes: dict[str, VirtualNode] = {}
        self.leader_events: list[LeaderEvent] = []
        self._rng = random.Random(seed)
        self._time = VirtualTime()
        self._slept_ns = 0
        self._asleep_true_ns: int | None = None
        self._leader_timer = Timer(self._time, self._pump_leader)
        rig = RequestedConfig(period_ns=period_ns, align_row=align_row, stagger=stagger)
        self._config = LeaderConfig(0, 0, rig)
        if exchanges_per_s is not None:
            self._config = replace(self._config, exchanges_per_s=exchanges_per_s)
        self.leader = self._new_leader()
        for spec in specs:
            self._time.schedule(spec.start_true_ns, self.start, spec)

    @property
    def now_true_ns(self) -> int:
        """Return the true time, which is the leader's, in ns."""
        return self._time.now_true_ns

    @property
    def leader_ns(self) -> int:
        """Return the reading of the leader's clock, in ns; it stands still while the leader is suspended."""
        true_ns = self.now_true_ns if self._asleep_true_ns is None else self._asleep_true_ns
        return true_ns - self._slept_ns

    def _new_leader(self) -> Leader:
        config = replace(self._config, instance=self._rng.getrandbits(32))
        return Leader(config, random.Random(self._rng.getrandbits(64)))

    # Actions of a test or an experiment

    def start(self, spec: NodeSpec) -> VirtualNode:
        """Start a node, or start it again after `kill`."""
        rng = random.Random(self._rng.getrandbits(64))
        config = ClientConfig(
            spec.name,
            rng.getrandbits(32),
            facts_of(spec.profile, width=spec.profile.image_width, height=spec.profile.image_rows),
            spec.tolerance_ns,
            clock_tolerance_ns=spec.clock_tolerance_ns,
            ring_ns=60 * spec.profile.period_ns,
            injection_profile=spec.injection_profile,
        )
        client: Client[SensorFrame] = Client(config, rng, spec.schedule())
        if spec.any_clock:
            client.timekeeper.target = AccuracyTarget()
        node = VirtualNode(spec, Sensor(spec.profile, rng), client, spec.link.open())
        node.timer = Timer(self._time, self._pump, node)
        self.nodes[spec.name] = node
        self._start_stream(node)
        self._pump(node)
        return node

    def kill(self, name: str) -> None:
        """Silence a node."""
        self.nodes[name].alive = False

    def restart_leader(self) -> None:
        """Silence the leader; another takes its place at the same address."""
        self.leader = self._new_leader()

    def suspend_leader(self) -> None:
        """Suspend the leader's machine, whose clock does not count that time."""
        self._asleep_true_ns = self.now_true_ns

    def wake_leader(self) -> None:
        """Let the leader's machine go on."""
        assert self._asleep_true_ns is not None, "it is suspended"
        self._slept_ns += self.now_true_ns - self._asleep_true_ns
        self._asleep_true_ns = None
        self._pump_leader()

    def trigger(self, **order: Any) -> Burst:
        """Order a burst with these fields of a `BurstOrder`."""
        burst = self.leader.trigger(self.leader_ns, BurstOrder(**order))
        self._pump_leader()
        return burst

    def end(self, burst: Burst, frames: int) -> Burst:
        """End a burst after this number of frames."""
        ended = self.leader.orders.end(burst, frames, self.leader_ns)
        self._pump_leader()
        return ended

    def cancel(self, burst: Burst) -> None:
        """Cancel a burst."""
        self.leader.orders.cancel(burst, self.leader_ns)
        self._pump_leader()

    def run_for(self, duration_ns: int) -> None:
        """Advance by this duration."""
        self._time.run_until(self.now_true_ns + duration_ns)

    def run_until(self, done: Callable[[], bool], *, limit_ns: int) -> bool:
        """Advance until `done()`, at most by `limit_ns`; return whether it became true."""
        return self._time.run_until(self.now_true_ns + limit_ns, done)

    def all_ready(self) -> bool:
        """Return whether the leader reports every node as ready."""
        return self._all_in(NodeState.READY)

    def all_usable(self) -> bool:
        """Return whether it reports every node as ready, or as DEGRADED where a node gets no better."""
        return self._all_in(NodeState.READY, NodeState.DEGRADED)

    def _all_in(self, *states: NodeState) -> bool:
        clients = self.leader.roster.by_name()
        return len(clients) == len(self.nodes) and all(c.report.state in states for c in clients)

    # The world

    def _start_stream(self, node: VirtualNode) -> None:
        if not node.alive:
            return
        node.sensor.stop()
        node.sensor.start(self.now_true_ns)
        node.client.stream_started(self._local(node))
        self._expect_frame(node)

    def _expect_frame(self, node: VirtualNode) -> None:
        frame = node.sensor.next_frame()
        self._time.schedule(frame.readout_end_true_ns + DELIVERY_NS, self._deliver_frame, node, frame)

    def _deliver_frame(self, node: VirtualNode, frame: SensorFrame) -> None:
        if not node.alive or not node.sensor.streaming or node.sensor.stream != frame.stream:
            return
        self._expect_frame(node)
        if not frame.dropped:
            timestamp_ns = node.spec.clock.local_from_true(frame.timestamp_true_ns)
            stamp = FrameStamp(frame.sequence, frame.stream, timestamp_ns)
            node.client.frames_arrived([(stamp, frame, 0)], self._local(node))
        self._pump(node)

    def _pump(self, node: VirtualNode) -> None:
        client = node.client
        if not node.alive:
            return
        if self._local(node) >= client.next_timer():
            client.handle_timer(self._local(node))
        for data in client.datagrams_to_send(self._local(node)):
            for delay_ns in node.channel.deliveries("to_leader", self.now_true_ns, self._rng):
                self._time.schedule(self.now_true_ns + delay_ns, self._to_leader, data, node)
        while (command := client.next_command()) is not None:
            self._apply(command, node)
        while (event := client.next_event()) is not None:
            node.events.append(event)
            if isinstance(event, FramesSelected):
                known = node.bursts.get(event.trigger.burst)
                if event.further and known is not None:
                    newest = event if event.trigger.streamed else known
                    event = replace(
                        newest, frames=(*known.frames, *event.frames), gaps=(*known.gaps, *event.gaps)
                    )
                node.bursts[event.trigger.burst] = event
        node.timer.set(node.spec.clock.true_from_local(client.next_timer()) + 1)

    def _apply(self, command: CameraCommand, node: VirtualNode) -> None:
        match command:
            case InjectFrame(exposure_ns):
                node.sensor.inject(exposure_ns, self.now_true_ns)
            case SetFrameDuration(duration_ns):
                node.sensor.set_frame_duration(duration_ns, self.now_true_ns)
            case RestartStream(delay_ns):
                node.sensor.stop()
                self._time.schedule(self.now_true_ns + delay_ns, self._start_stream, node)

    def _to_leader(self, data: bytes, node: VirtualNode) -> None:
        if self._asleep_true_ns is None:
            self.leader.receive_datagram(data, (node.spec.name, 0), self.leader_ns)
            self._pump_leader()

    def _to_client(self, data: bytes, node: VirtualNode) -> None:
        if node.alive:
            node.client.receive_datagram(data, self._local(node))
            self._pump(node)

    def _pump_leader(self) -> None:
        if self._asleep_true_ns is not None:
            return
        due_ns = self.leader.next_timer()
        if due_ns is not None and self.leader_ns >= due_ns:
            self.leader.handle_timer(self.leader_ns)
        for data, (name, _) in self.leader.datagrams_to_send(self.leader_ns):
            node = self.nodes[name]
            for delay_ns in node.channel.deliveries("to_client", self.now_true_ns, self._rng):
                self._time.schedule(self.now_true_ns + delay_ns, self._to_client, data, node)
        while (event := self.leader.next_event()) is not None:
            self.leader_events.append(event)
        if (due_ns := self.leader.next_timer()) is not None:
            self._leader_timer.set(due_ns + self._slept_ns)

    def _local(self, node: VirtualNode) -> int:
        return node.spec.clock.local_from_true(self.now_true_ns)
