"""Thousands of clocks in virtual time: the engine's own leader, relays and followers, without cameras.

A tree is cut below its root into shards. Each is simulated with a root of its own, so shards run in parallel
and the result does not depend on the number of processes.
"""

import hashlib
import random
from array import array
from collections.abc import Callable
from dataclasses import dataclass, field
from math import nan
from time import perf_counter_ns

from benchmarks.simulated.changing_clocks import WanderingClock, draw_wandering_clock
from benchmarks.simulated.links import Channel, Link
from benchmarks.simulated.virtual_rig import Timer, VirtualTime
from benchmarks.simulated.wireless import PAPER_LINK
from capture_app.sync.rig.leader_engine import Leader, LeaderConfig
from capture_app.sync.rig.rig_config import RequestedConfig
from capture_app.sync.sync_engine import Address, Engine
from capture_app.sync.timekeeping.poll_schedule import Progress, TreeSchedule
from capture_app.sync.tree.member import TreeMember
from capture_app.sync.tree.relay_engine import Relay

_S = 1_000_000_000
PERIOD_NS = 33_333_333
RIG = RequestedConfig(period_ns=PERIOD_NS)
ROOT: Address = ("root", 0)


class OnceASecond(TreeSchedule):
    """Schedule with one request per second from the start."""

    def _interval(self, progress: Progress | None = None) -> int:
        return _S


@dataclass(frozen=True, slots=True)
class TreeSpec:
    """A tree of clocks: relays below the root with clients spread over them, or clients below the root."""

    clients: int
    relays: int
    duration_s: float = 3600.0
    client_pace_s: float = 1.2
    """Mean time between two exchanges of a client."""
    relay_pace_s: float = 0.25
    """Mean time between two exchanges of a relay."""
    link: Link = PAPER_LINK
    sample_every_s: float = 10.0
    """Time between two instants at which the clocks are compared with the truth."""
    join_within_s: float = 2.0
    """All nodes start within this time."""
    wander_ppm: float = 0.3
    sparing: bool = False
    """Whether clients ask once a second from the start: a tenth of the messages of the first minute."""


@dataclass(slots=True, eq=False)
class _Node:
    address: Address
    engine: Engine
    clock: WanderingClock
    rng: random.Random
    channel: Channel
    """Channel to the node's parents."""
    member: TreeMember | None = None
    parents: frozenset[Address] = frozenset()
    timer: Timer = field(init=False)
    due_ns: int | None = None
    """Local time at which the timer is due."""
    alive: bool = True
    queued: list[tuple[bytes, Address]] | None = None
    """Datagrams for a frozen node; None if what arrives while it is not alive is lost."""
    datagrams: int = 0


class Tree:
    """A running shard of a tree."""

    def __init__(self, spec: TreeSpec, *, seed: int, shard: int = 0, shards: int = 1) -> None:
        self.spec = spec
        self.nodes: dict[Address, _Node] = {}
        self.datagrams = self.root_busy_ns = 0
        self._seed = seed
        self._shard = shard
        self._digest = hashlib.blake2b(digest_size=16)
        self._arrived: list[bytes] = []
        self._arrivals = array("q")
        """Datagrams and their true times that the digest does not contain yet."""
        self.time = VirtualTime()
        """The shard's schedule; a test has relays killed and revived by it."""
        relays = range(shard, spec.relays, shards)
        clients = range(shard, spec.clients, shards)
        below = len(relays) or len(clients)
        pace_s = spec.relay_pace_s if relays else spec.client_pace_s
        self.root = Leader(LeaderConfig(1, 0, RIG, exchanges_per_s=below / pace_s), self._rng("root"))
        rng, clock = self._rng("root's link"), WanderingClock(0, 0.0, ())
        self._start(_Node(ROOT, self.root, clock, rng, spec.link.open()), 0)
        for i in relays:
            self._add_relay(i, max(1.0, len(clients) / len(relays)))
        addresses = [(f"relay{i}", 0) for i in relays]
        for i, client in enumerate(clients):
            # Its own relay, then the next ones; without relays, the root.
            own = [addresses[(i + k) % len(addresses)] for k in range(min(3, len(addresses)))]
            self._add_client(client, (*own,) if own else (ROOT,))

    @property
    def now_true_ns(self) -> int:
        """Return the true time, which is the root's, in ns."""
        return self.time.now_true_ns

    def run(self, each: Callable[[], None] | None = None) -> None:
        """Run the tree for its duration; `each` is called at every sampling instant."""
        step_ns = round(self.spec.sample_every_s * _S)
        for at_ns in range(step_ns, round(self.spec.duration_s * _S) + 1, step_ns):
            self.run_until(at_ns)
            if each is not None:
                each()

    @property
    def digest(self) -> str:
        """Return a digest of every datagram and its arrival time: the same for the same seed."""
        return self._digest.hexdigest()

    def run_until(self, end_true_ns: int) -> None:
        """Advance to a true time in ns."""
        self.time.run_until(end_true_ns)
        self.datagrams += len(self._arrived)
        self._digest.update(b"".join(self._arrived))
        self._digest.update(self._arrivals.tobytes())
        self._arrived.clear()
        del self._arrivals[:]

    def kill(self, name: str) -> None:
        """Silence a node."""
        self.nodes[name, 0].alive = False

    def revive(self, name: str) -> None:
        """Let a silenced or frozen node continue where it stopped."""
        node = self.nodes[name, 0]
        queued, node.alive, node.queued = node.queued or (), True, None
        for data, sender in queued:
            self._act(node, data, sender)
        self._act(node)

    def act(self, name: str) -> None:
        """Let a node run its timers and send what is due, after a request to its engine."""
        self._act(self.nodes[name, 0])

    # Building

    def add(
        self,
        name: str,
        engine: Engine,
        rng: random.Random,
        parents: tuple[Address, ...],
        member: TreeMember | None = None,
    ) -> WanderingClock:
        """Add a node below the parents; its clock and all its randomness are drawn from `rng`."""
        clock = draw_wandering_clock(rng, wander_ppm=self.spec.wander_ppm)
        channel = self.spec.link.open()
        node = _Node((name, 0), engine, clock, rng, channel, member, frozenset(parents))
        self._start(node, round(rng.uniform(0.0, self.spec.join_within_s) * _S))
        return clock

    def _rng(self, name: str) -> random.Random:
        return random.Random(f"{self._seed} {self._shard} {name}")

    def _add_relay(self, number: int, clients: float) -> None:
        name = f"relay{number}"
        rng = self._rng(name)
        member = TreeMember(name, rng.getrandbits(32), (ROOT,), rng)
        limits = LeaderConfig(0, 0, RIG, exchanges_per_s=clients / self.spec.client_pace_s)
        relay = Relay(member, limits, rng)
        self.add(name, relay, rng, member.leaders, member)

    def _add_client(self, number: int, parents: tuple[Address, ...]) -> None:
        name = f"client{number}"
        rng = self._rng(name)
        member = TreeMember(name, rng.getrandbits(32), parents, rng)
        if self.spec.sparing:
            member.time.timekeeper.schedule = OnceASecond()
        self.add(name, member, rng, parents, member)

    def _start(self, node: _Node, start_true_ns: int) -> None:
        self.nodes[node.address] = node
        node.timer = Timer(self.time, self._act, node)
        node.timer.set(start_true_ns)

    # Running

    def _act(self, node: _Node, data: bytes | None = None, sender: Address = ROOT) -> None:
        """Let a node process a datagram or run its timers, and send what is due."""
        if not node.alive:
            if node.queued is not None and data is not None:
                node.queued.append((data, sender))
            return
        true_ns = self.now_true_ns
        if data is not None:
            node.datagrams += 1
            self._arrived.append(data)
            self._arrivals.append(true_ns)
        if node.engine is not self.root:
            self._turn(node, data, sender, true_ns)
            return
        began_ns = perf_counter_ns()
        self._turn(node, data, sender, true_ns)
        self.root_busy_ns += perf_counter_ns() - began_ns

    def _turn(self, node: _Node, data: bytes | None, sender: Address, true_ns: int) -> None:
        engine, schedule = node.engine, self.time.schedule
        local_ns = node.clock.local_from_true(true_ns)
        if data is None:
            engine.handle_timer(local_ns)
        else:
            engine.receive_datagram(data, sender, local_ns)
        for outgoing, address in engine.datagrams_to_send(local_ns):
            node.datagrams += 1
            other = self.nodes[address]
            if address in node.parents:
                delays_ns = node.channel.deliveries("to_leader", true_ns, node.rng)
            else:
                delays_ns = other.channel.deliveries("to_client", true_ns, node.rng)
            for delay_ns in delays_ns:
                schedule(true_ns + delay_ns, self._act, other, outgoing, node.address)
        due_ns = engine.next_timer()
        if due_ns is not None and not (due_ns == node.due_ns and node.timer.is_pending):
            node.due_ns = due_ns
            node.timer.set(node.clock.true_from_local(due_ns) + 1)


@dataclass(slots=True)
class TreeResult:
    """The measurements of a shard."""

    instants_s: list[float] = field(default_factory=list)
    errors_us: list[list[float]] = field(default_factory=list)
    """Errors of each client at each instant; nan without a time map."""
    within_95: int = 0
    """Number of errors within the stated 95 % uncertainty."""
    within_bound: int = 0
    """Number of errors within the hard bound."""
    judged: int = 0
    """Number of errors."""
    root_datagrams: int = 0
    """Datagrams that the root received or sent."""
    root_busy_ns: int = 0
    """Processor time inside the root's engine, measured on this machine."""
    busiest_relay_datagrams: int = 0
    datagrams: int = 0
    digest: str = ""
    """Digest of every datagram and its arrival time: the same for the same seed."""

    def settled(self, after_s: float) -> list[list[float]]:
        """Return the errors of clients with a time map, at each instant after this time."""
        found = zip(self.instants_s, self.errors_us, strict=True)
        return [[error for error in errors if error == error] for at_s, errors in found if at_s > after_s]


def measure(tree: Tree) -> TreeResult:
    """Run a tree, and compare every client's time with the truth at each sampling instant."""
    result = TreeResult()
    clients = [
        (node.engine, node.clock) for node in tree.nodes.values() if isinstance(node.engine, TreeMember)
    ]

    def sample() -> None:
        now_true_ns, errors = tree.now_true_ns, []
        for member, clock in clients:
            time_map = member.time.time_map
            if time_map is None:
                errors.append(nan)
                continue
            local_ns = clock.local_from_true(now_true_ns)
            error_ns = time_map.leader_from_local(local_ns) - now_true_ns
            result.judged += 1
            result.within_95 += abs(error_ns) <= time_map.uncertainty_at(local_ns)
            result.within_bound += abs(error_ns) <= time_map.hard_bound_at(local_ns)
            errors.append(error_ns / 1000.0)
        result.instants_s.append(now_true_ns / 1e9)
        result.errors_us.append(errors)

    tree.run(sample)
    result.root_datagrams = tree.nodes[ROOT].datagrams
    result.root_busy_ns = tree.root_busy_ns
    relays = [node.datagrams for node in tree.nodes.values() if isinstance(node.engine, Relay)]
    result.busiest_relay_datagrams = max(relays, default=0)
    result.datagrams, result.digest = tree.datagrams, tree.digest
    return result


def run_shard(spec: TreeSpec, seed: int, shard: int, shards: int) -> TreeResult:
    """Simulate one shard of a tree."""
    return measure(Tree(spec, seed=seed, shard=shard, shards=shards))
