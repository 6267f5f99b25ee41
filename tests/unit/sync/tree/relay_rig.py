"""A root with relays and cameras below it in virtual time, as a test puts them together."""

import random
from collections import Counter
from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Protocol, TypeVar

from msgspec import structs

from benchmarks.simulated.changing_clocks import WanderingClock
from benchmarks.simulated.clock_tree import ROOT, Tree, TreeSpec
from capture_app.common.node_state import NodeState
from capture_app.sync.phase.estimator import FrameStamp
from capture_app.sync.rig.burst_orders import BurstOrder
from capture_app.sync.rig.client import Client, ClientConfig
from capture_app.sync.rig.events import LeaderEvent, TriggerAnswered
from capture_app.sync.rig.failover import PROBE_EVERY_NS, Failover
from capture_app.sync.rig.frame_selection import Burst, FramesSelected
from capture_app.sync.rig.leader_engine import Leader, LeaderConfig
from capture_app.sync.rig.roster import Member
from capture_app.sync.sync_engine import Address
from capture_app.sync.tree.member import TreeMember
from capture_app.sync.tree.relay_engine import OF_CAMERAS, Relay
from capture_app.sync.wire.codec import decode
from tests.facts import make_facts

S = 1_000_000_000
PERIOD_NS = 33_333_333
CAMERA = make_facts(period_ns=PERIOD_NS)


@dataclass
class Camera:
    """A client whose frames come at whole periods of its own clock; each frame is its own timestamp."""

    client: Client[int]
    leaders: tuple[Address, ...]
    probe_every_ns: int = PROBE_EVERY_NS
    events: list[object] = field(default_factory=list)
    clock: WanderingClock = field(init=False)
    failover: Failover = field(init=False)
    _next_ns: int | None = None
    _frames: int = 0

    def __post_init__(self) -> None:
        self.failover = Failover(self.client, self.leaders, self.probe_every_ns)
        self.receive_datagram = self.failover.receive_datagram
        self.datagrams_to_send = self.failover.datagrams_to_send

    def next_timer(self) -> int:
        due_ns = self.failover.next_timer()
        return due_ns if self._next_ns is None else min(self._next_ns, due_ns)

    def handle_timer(self, now_ns: int) -> None:
        if self._next_ns is None:
            self._next_ns = now_ns
        while now_ns >= self._next_ns:
            self.client.frames_arrived(
                [(FrameStamp(self._frames, 0, self._next_ns), self._next_ns, 0)], now_ns
            )
            self._frames += 1
            self._next_ns += PERIOD_NS
        self.failover.handle_timer(now_ns)
        while (event := self.client.next_event()) is not None:
            self.events.append(event)

    @property
    def ready(self) -> list[FramesSelected[int]]:
        return [event for event in self.events if isinstance(event, FramesSelected)]


@dataclass
class Counted:
    """A leader, and how many messages of each kind it gets and sends."""

    engine: Leader
    heard: Counter[str]
    sent: Counter[str]

    def __post_init__(self) -> None:
        self.next_timer, self.handle_timer = self.engine.next_timer, self.engine.handle_timer

    def receive_datagram(self, data: bytes, address: Address, now_ns: int) -> None:
        self.heard[type(decode(data)).__name__] += 1
        self.engine.receive_datagram(data, address, now_ns)

    def datagrams_to_send(self, now_ns: int) -> list[tuple[bytes, Address]]:
        datagrams = self.engine.datagrams_to_send(now_ns)
        self.sent.update(type(decode(data)).__name__ for data, _ in datagrams)
        return datagrams


class RelayRig:
    """A root and whatever a test puts below it, on the paper's link."""

    def __init__(self, seed: int = 7, probe_every_ns: int = PROBE_EVERY_NS) -> None:
        self.probe_every_ns = probe_every_ns
        self.tree = Tree(TreeSpec(clients=0, relays=0, join_within_s=0.0), seed=seed)
        self.tree.root.config = replace(self.tree.root.config, exchanges_per_s=1000.0)
        self.events: list[LeaderEvent] = []
        self.heard_at_root: Counter[str] = Counter()
        self.sent_by_root: Counter[str] = Counter()
        self.tree.nodes[ROOT].engine = Counted(self.tree.root, self.heard_at_root, self.sent_by_root)
        self.cameras: dict[str, Camera] = {}
        self.relays: dict[str, Relay] = {}

    def relay(self, name: str, *parents: Address) -> Address:
        rng = random.Random(name)
        instance = rng.getrandbits(32)
        member = TreeMember(name, instance, parents, rng, OF_CAMERAS)
        relay = self.relays[name] = Relay(member, LeaderConfig(0, 0), rng)
        self.tree.add(name, relay, rng, parents, member)
        return name, 0

    def camera(self, name: str, *leaders: Address, at: str = "", control: str = "none") -> Camera:
        rng = random.Random(at or name)
        camera = structs.replace(CAMERA, phase_control=control)
        client: Client[int] = Client(ClientConfig(name, rng.getrandbits(32), camera, 300_000, 90), rng)
        node = self.cameras[at or name] = Camera(client, leaders, self.probe_every_ns)
        node.clock = self.tree.add(at or name, node, rng, leaders)
        return node

    def run(self, seconds: float) -> None:
        end_ns = self.tree.now_true_ns + round(seconds * S)
        while self.tree.now_true_ns < end_ns:
            self.tree.run_until(min(end_ns, self.tree.now_true_ns + S // 20))
            while (event := self.tree.root.next_event()) is not None:
                self.events.append(event)

    def run_until(self, condition: Callable[[], bool], limit_s: float = 60.0) -> None:
        for _ in range(round(limit_s * 20)):
            if condition():
                return
            self.run(0.05)
        raise AssertionError([event for camera in self.cameras.values() for event in camera.events])

    def kill(self, name: str) -> None:
        self.tree.kill(name)

    def views(self) -> dict[str, Member]:
        return {view.name: view for view in self.tree.root.roster.by_name()}

    def hard_bound_now_ns(self, name: str) -> float:
        client = self.cameras[name].client if name in self.cameras else self.relays[name].member.time
        assert client.time_map is not None
        now_ns = self.tree.nodes[name, 0].clock.local_from_true(self.tree.now_true_ns)
        return client.time_map.hard_bound_at(now_ns)

    def all_ready(self) -> bool:
        views = self.views()
        return all(
            name in views and views[name].report.state is NodeState.READY
            for name in (*self.cameras, *self.relays)
            if self.tree.nodes[name, 0].alive
        )

    def trigger(self, frames: int, *, after_s: int | None = None) -> Burst:
        now_ns = self.tree.now_true_ns
        at_ns = None if after_s is None else now_ns + after_s * S
        burst = self.tree.root.trigger(now_ns, BurstOrder(frames=frames, at_leader_ns=at_ns))
        self.tree.act("root")
        return burst

    def check_burst(self, frames: int = 3) -> None:
        """Order a burst of all, and hold what they picked against the truth."""
        had = {name: len(camera.ready) for name, camera in self.cameras.items()}
        burst = self.trigger(frames)
        self.run(2.0)
        assert set(burst.clients) == set(self.cameras)
        answers = [e for e in self.events if isinstance(e, TriggerAnswered) and e.burst == burst.number]
        assert {(e.name, e.refusal) for e in answers} == {(name, "") for name in self.cameras}
        for name, camera in self.cameras.items():
            assert len(camera.ready) == had[name] + 1, name
            ready = camera.ready[-1]
            assert (ready.trigger.leader, ready.trigger.burst) == (
                self.tree.root.config.instance,
                burst.number,
            )
            assert [pick.instant for pick in ready.frames] == list(range(frames))
            for pick in ready.frames:
                true_ns = camera.clock.true_from_local(pick.frame)
                assert abs(pick.leader_ns - true_ns) <= pick.hard_bound_ns
                assert abs(pick.leader_ns - true_ns) < 300_000
                assert abs(pick.residual_ns) <= PERIOD_NS // 2


class HasTree(Protocol):
    tree: Tree


AnyRig = TypeVar("AnyRig", bound=HasTree)


def copy_of(rig: AnyRig) -> AnyRig:
    """A rig in the same state, which goes on as this one would."""
    digest = rig.tree._digest
    return deepcopy(rig, {id(digest): digest.copy()})


def camera_below_a_relay(probe_every_ns: int = PROBE_EVERY_NS) -> tuple[RelayRig, Camera]:
    """A camera that is ready below a relay, and would follow the root without it."""
    rig = copy_of(run_until_ready(probe_every_ns))
    return rig, rig.cameras["cam"]


@cache
def run_until_ready(probe_every_ns: int) -> RelayRig:
    """The same one for all tests, which copy it."""
    rig = RelayRig(probe_every_ns=probe_every_ns)
    rig.camera("cam", rig.relay("relay", ROOT), ROOT)
    rig.run_until(rig.all_ready)
    return rig
