"""Nodes with the driver's own code on doubles of libcamera, below a leader, in a stepped loop's time.

Leader, clients and supervisors are the program's own; links are drawn from a law, clocks run apart. The
leader's clock is the loop's, which is true time here.
"""

import asyncio
import random
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from typing import Any, cast

from benchmarks.simulated.links import Link
from capture_app.cameras.frames import CapturedFrame
from capture_app.cameras.specs import CameraRequest
from capture_app.common.node_state import NodeState
from capture_app.net.udp import Pump
from capture_app.node.camera.supervisor import CameraSupervisor, NodeOptions
from capture_app.plugins.cameras.libcamera.libcamera_driver import LibcameraCamera
from capture_app.plugins.cameras.libcamera.libcamera_stream import Library, StampClock
from capture_app.protocol.log import Log
from capture_app.sync.rig.client import Client, ClientConfig
from capture_app.sync.rig.leader_engine import Leader, LeaderConfig
from tests.unit.plugins.cameras.libcamera.double import libcamera_double
from tests.unit.plugins.cameras.libcamera.double_camera import Camera, Sensor
from tests.unit.plugins.cameras.sim.simulation_driver.stepped import LoopClock, true_now_ns


class Inline(Executor):
    """Does what it is given at once: no thread runs beside a stepped loop."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> "Future[Any]":
        done: Future[Any] = Future()
        try:
            done.set_result(fn(*args, **kwargs))
        except BaseException as error:
            done.set_exception(error)
        return done


class LoopStampClock(StampClock):
    """A machine's clocks in a stepped loop's time: it never sleeps."""

    def now_ns(self) -> int:
        return true_now_ns()

    def boot_ns(self) -> int:
        return true_now_ns()


LOOP_CLOCK = LoopStampClock()


def open_double(library: Library, number: int, **wishes: Any) -> LibcameraCamera:
    return LibcameraCamera(library, str(number), CameraRequest(**wishes), clock=LOOP_CLOCK, executor=Inline())


@dataclass(frozen=True)
class NodeSpec:
    """A node: its sensor, and the clock that it keeps."""

    sensor: Sensor
    clock: LoopClock


class Node:
    def __init__(self, rig: "Rig", number: int, spec: NodeSpec) -> None:
        self.rig, self.clock, self.name = rig, spec.clock, f"pi{number}"
        self.double: Camera = rig.library.cameras[number]
        self.channel = rig.link.open()
        self.options = NodeOptions(
            name=self.name,
            open_camera=lambda: open_double(rig.library, number).in_clock(spec.clock),
            leaders=(),
            clock=spec.clock,
            log=Log(rig.said.append),
        )
        self.supervisor = CameraSupervisor(self.options)
        self.client: Client[CapturedFrame]
        self._timer: asyncio.TimerHandle | None = None

    async def run(self, rng: random.Random) -> None:
        await self.supervisor.open()
        facts = self.supervisor.facts
        config = ClientConfig(self.name, rng.getrandbits(32), facts, self.rig.tolerance_ns)
        self.client = Client(config, rng)
        self.supervisor.connect(self.client, cast(Pump, self))
        self.turn()
        await self.supervisor.carry_out_commands()

    def turn(self) -> None:
        now_ns, client = self.clock.now_ns(), self.client
        if now_ns >= client.next_timer():
            client.handle_timer(now_ns)
        for data in client.datagrams_to_send(now_ns):
            self.rig.post(
                self.channel.deliveries("to_leader", true_now_ns(), self.rig.rng), self._to_leader, data
            )
        self.supervisor.collect_commands()
        while client.next_event() is not None:
            pass
        if self._timer is not None:
            self._timer.cancel()
        due_s = (self.clock.true_from_local(client.next_timer()) + 1) / 1e9
        self._timer = asyncio.get_running_loop().call_at(due_s, self.turn)

    def _to_leader(self, data: bytes) -> None:
        self.rig.leader.receive_datagram(data, (self.name, 0), true_now_ns())
        self.rig.turn()

    def receive(self, data: bytes) -> None:
        self.client.receive_datagram(data, self.clock.now_ns())
        self.turn()


class Rig:
    """Runs in a stepped loop: `async with` it."""

    def __init__(
        self, specs: Sequence[NodeSpec], link: Link, *, seed: int, tolerance_ns: int = 60_000
    ) -> None:
        self.rng, self.link, self.tolerance_ns = random.Random(seed), link, tolerance_ns
        self.said: list[str] = []
        self.library = Library(libcamera_double(*(spec.sensor for spec in specs)))
        self.nodes = [Node(self, number, spec) for number, spec in enumerate(specs)]
        self.leader = Leader(LeaderConfig(0, 1), random.Random(seed))
        self._timer: asyncio.TimerHandle | None = None
        self._tasks: list[asyncio.Task[None]] = []

    async def __aenter__(self) -> "Rig":
        self._tasks = [
            asyncio.create_task(node.run(random.Random(self.rng.getrandbits(64)))) for node in self.nodes
        ]
        return self

    async def __aexit__(self, *_: object) -> None:
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        for node in self.nodes:
            await node.supervisor.camera.stop()

    @property
    def all_ready(self) -> bool:
        clients = self.leader.roster.by_name()
        return len(clients) == len(self.nodes) and all(c.report.state is NodeState.READY for c in clients)

    def post(self, delays_ns: Sequence[int], action: Callable[..., None], data: bytes) -> None:
        for delay_ns in delays_ns:
            asyncio.get_running_loop().call_later(delay_ns / 1e9, action, data)

    def turn(self) -> None:
        now_ns = true_now_ns()
        due_ns = self.leader.next_timer()
        if due_ns is not None and now_ns >= due_ns:
            self.leader.handle_timer(now_ns)
        by_name = {node.name: node for node in self.nodes}
        for data, (name, _) in self.leader.datagrams_to_send(now_ns):
            node = by_name[name]
            self.post(node.channel.deliveries("to_client", now_ns, self.rng), node.receive, data)
        while self.leader.next_event() is not None:
            pass
        if self._timer is not None:
            self._timer.cancel()
        if (due_ns := self.leader.next_timer()) is not None:
            self._timer = asyncio.get_running_loop().call_at(due_ns / 1e9, self.turn)

    def spreads_ns(self) -> list[int]:
        """How far apart the true starts of exposure were at each instant since the last call."""
        grid = self.leader.current.grid
        assert grid is not None
        starts: dict[int, list[int]] = {}
        for node in self.nodes:
            for frame in node.double.frames:
                starts.setdefault(grid.index_of(frame.exposed_from_ns), []).append(frame.exposed_from_ns)
            node.double.frames.clear()
        return [max(some) - min(some) for some in starts.values() if len(some) == len(self.nodes)]
