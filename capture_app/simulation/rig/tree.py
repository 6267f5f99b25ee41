"""Thousands of clocks in virtual time: the engine's own leader, relays and followers, and nothing else.

A tree is cut below its root into shares, each simulated by itself with a root of its own that bears no more
than its share; so shares run in parallel, and the result is the same in one process or in many.
"""

import hashlib
import heapq
import random
from array import array
from collections.abc import Callable
from dataclasses import dataclass, field
from time import perf_counter_ns, process_time
from typing import Protocol

from capture_app.simulation.network.link import DeliveryDraw, Link, delivery_draw
from capture_app.simulation.network.paper_link import PAPER_LINK
from capture_app.simulation.network.wandering_clock import WanderingClock, draw_wandering_clock
from capture_app.sync.rig.leader import Leader, LeaderConfig
from capture_app.sync.tree.follower import Address, Follower, FollowerConfig
from capture_app.sync.tree.relay import Relay

_S = 1_000_000_000
PERIOD_NS = 33_333_333
ROOT: Address = ("root", 0)


class Engine(Protocol):
    """What leaders, relays and followers have in common; times in ns of the node's own clock."""

    def receive_datagram(self, data: bytes, address: Address, now_ns: int) -> None:
        """Take in one datagram."""

    def datagrams_to_send(self, now_ns: int) -> list[tuple[bytes, Address]]:
        """Return what is due, stamped with `now_ns`."""

    def next_timer(self) -> int | None:
        """Return when to call `handle_timer`."""

    def handle_timer(self, now_ns: int) -> None:
        """Do what has become due."""


@dataclass(frozen=True, slots=True)
class Death:
    """A relay falls silent without a word at a true time in ns, for good or until another."""

    relay: int
    true_ns: int
    until_true_ns: int | None = None


@dataclass(frozen=True, slots=True)
class TreeSpec:
    """A tree of clocks: `relays` under the root, `clients` spread over them; or all under the root.

    `client_pace_s` and `relay_pace_s` are the mean times between two exchanges of a client and of a relay.
    """

    clients: int
    relays: int
    duration_s: float = 3600.0
    client_pace_s: float = 1.2
    relay_pace_s: float = 0.25
    link: Link = PAPER_LINK
    sample_every_s: float = 10.0
    join_within_s: float = 2.0
    wander_ppm: float = 0.3
    deaths: tuple[Death, ...] = ()


@dataclass(slots=True)
class TreeResult:
    """What was measured at each sampling instant, over all shares; errors in us, nan without a time."""

    instants_s: list[float] = field(default_factory=list)
    errors_us: list[list[float]] = field(default_factory=list)
    within_95: int = 0
    within_bound: int = 0
    judged: int = 0
    root_datagrams: int = 0
    """That reached the root or left it."""
    root_busy_ns: int = 0
    """Processor time inside the root's engine, measured on this machine."""
    processor_s: float = 0.0
    """Of the whole simulation."""
    busiest_relay_datagrams: int = 0
    datagrams: int = 0
    digest: str = ""
    """Of every datagram and when it arrived: the same for the same seed."""


@dataclass(slots=True, eq=False)
class _Node:
    address: Address
    engine: Engine
    clock: WanderingClock
    rng: random.Random
    follower: Follower | None = None
    parents: frozenset[Address] = frozenset()
    alive: bool = True
    timer_true_ns: int = -1
    due_ns: int | None = None
    """What that timer stands for, local time."""
    datagrams: int = 0


class Tree:
    """One share of a tree that runs."""

    def __init__(self, spec: TreeSpec, *, seed: int, share: int = 0, shares: int = 1) -> None:
        self.spec = spec
        self.now_true_ns = 0
        self.nodes: dict[Address, _Node] = {}
        self.datagrams = self.root_busy_ns = 0
        self._seed = seed
        self._share = share
        self._to_leader: DeliveryDraw = delivery_draw(spec.link, spec.link.to_leader)
        self._to_client: DeliveryDraw = delivery_draw(spec.link, spec.link.to_client)
        self._digest = hashlib.blake2b(digest_size=16)
        self._arrived: list[bytes] = []
        self._arrivals = array("q")
        """What the digest is yet to take in."""
        self._heap: list[tuple[int, int, _Node, bytes | None, Address]] = []
        self._scheduled = 0
        relays = range(share, spec.relays, shares)
        clients = range(share, spec.clients, shares)
        below = len(relays) or len(clients)
        pace_s = spec.relay_pace_s if relays else spec.client_pace_s
        self.root = Leader(LeaderConfig(1, 0, PERIOD_NS, exchanges_per_s=below / pace_s), self._rng("root"))
        self._start(_Node(ROOT, self.root, WanderingClock(0, 0.0, ()), self._rng("root's link")), 0)
        for i in relays:
            self._add_relay(i, max(1.0, len(clients) / len(relays)))
        addresses = [(f"relay{i}", 0) for i in relays]
        for i, client in enumerate(clients):
            # Its own relay, then the next ones; without relays, the root.
            own = [addresses[(i + k) % len(addresses)] for k in range(min(3, len(addresses)))]
            self._add_client(client, (*own,) if own else (ROOT,))
        mine = [d for d in spec.deaths if d.relay in relays]
        falls = [(d.true_ns, d.relay, False) for d in mine]
        returns = [(d.until_true_ns, d.relay, True) for d in mine if d.until_true_ns is not None]
        self._turns_of_fate = sorted(falls + returns)

    def run(self, each: Callable[[], None] | None = None) -> None:
        """Let the duration of the tree pass; `each` is called at every sampling instant."""
        step_ns = round(self.spec.sample_every_s * _S)
        for at_ns in range(step_ns, round(self.spec.duration_s * _S) + 1, step_ns):
            while self._turns_of_fate and self._turns_of_fate[0][0] <= at_ns:
                true_ns, relay, alive = self._turns_of_fate.pop(0)
                self._run_until(true_ns)
                node = self.nodes[f"relay{relay}", 0]
                node.alive = alive
                if alive:
                    self._start(node, true_ns)
            self._run_until(at_ns)
            if each is not None:
                each()

    def measure(self) -> TreeResult:
        """Run it, and compare every client's time with the truth at each sampling instant."""
        result = TreeResult()
        clients = [
            n for n in self.nodes.values() if n.follower is not None and isinstance(n.engine, Follower)
        ]

        def sample() -> None:
            errors: list[float] = []
            for node in clients:
                assert node.follower is not None
                time_map = node.follower.time_map
                if time_map is None:
                    errors.append(float("nan"))
                    continue
                local_ns = node.clock.local_from_true(self.now_true_ns)
                error_ns = time_map.leader_from_local(local_ns) - self.now_true_ns
                result.judged += 1
                result.within_95 += abs(error_ns) <= time_map.uncertainty_at(local_ns)
                result.within_bound += abs(error_ns) <= time_map.hard_bound_at(local_ns)
                errors.append(error_ns / 1000.0)
            result.instants_s.append(self.now_true_ns / _S)
            result.errors_us.append(errors)

        self.run(sample)
        result.root_datagrams = self.nodes[ROOT].datagrams
        result.root_busy_ns = self.root_busy_ns
        relays = [node.datagrams for node in self.nodes.values() if isinstance(node.engine, Relay)]
        result.busiest_relay_datagrams = max(relays, default=0)
        result.datagrams = self.datagrams
        result.digest = self._digest.hexdigest()
        return result

    # Building

    def add(
        self,
        name: str,
        engine: Engine,
        rng: random.Random,
        parents: tuple[Address, ...],
        follower: Follower | None = None,
    ) -> WanderingClock:
        """Add a node below the parents, with a clock drawn for it; all its chance comes from `rng`."""
        clock = draw_wandering_clock(rng, wander_ppm=self.spec.wander_ppm)
        node = _Node((name, 0), engine, clock, rng, follower, frozenset(parents))
        self._start(node, round(rng.uniform(0.0, self.spec.join_within_s) * _S))
        return clock

    def _rng(self, name: str) -> random.Random:
        return random.Random(f"{self._seed} {self._share} {name}")

    def _add_relay(self, number: int, clients: float) -> None:
        name = f"relay{number}"
        rng = self._rng(name)
        config = FollowerConfig(name, rng.getrandbits(32), (ROOT,))
        limits = LeaderConfig(0, 0, PERIOD_NS, exchanges_per_s=clients / self.spec.client_pace_s)
        relay = Relay(config, limits, rng)
        self.add(name, relay, rng, config.parents, relay.follower)

    def _add_client(self, number: int, parents: tuple[Address, ...]) -> None:
        name = f"client{number}"
        rng = self._rng(name)
        follower = Follower(FollowerConfig(name, rng.getrandbits(32), parents), rng)
        self.add(name, follower, rng, parents, follower)

    def _start(self, node: _Node, start_true_ns: int) -> None:
        self.nodes[node.address] = node
        node.timer_true_ns = start_true_ns
        self._push(start_true_ns, node, None, ROOT)

    # Running

    def _push(self, true_ns: int, node: _Node, data: bytes | None, sender: Address) -> None:
        self._scheduled += 1
        heapq.heappush(self._heap, (true_ns, self._scheduled, node, data, sender))

    def _run_until(self, end_true_ns: int) -> None:
        heap, root, turn, pop = self._heap, self.root, self._turn, heapq.heappop
        arrived, arrivals = self._arrived, self._arrivals
        while heap and heap[0][0] <= end_true_ns:
            true_ns, _, node, data, sender = pop(heap)
            if not node.alive or (data is None and true_ns != node.timer_true_ns):
                continue
            self.now_true_ns = true_ns
            if data is not None:
                node.datagrams += 1
                arrived.append(data)
                arrivals.append(true_ns)
            if node.engine is root:
                began_ns = perf_counter_ns()
                turn(node, data, sender)
                self.root_busy_ns += perf_counter_ns() - began_ns
            else:
                turn(node, data, sender)
        self.now_true_ns = end_true_ns
        self.datagrams += len(arrived)
        self._digest.update(b"".join(arrived))
        self._digest.update(arrivals.tobytes())
        arrived.clear()
        del arrivals[:]

    def _turn(self, node: _Node, data: bytes | None, sender: Address) -> None:
        """Let an engine take in a datagram or look at its timers, and carry off what it sends."""
        true_ns, engine = self.now_true_ns, node.engine
        local_ns = node.clock.local_from_true(true_ns)
        if data is None:
            engine.handle_timer(local_ns)
        else:
            engine.receive_datagram(data, sender, local_ns)
        for outgoing, address in engine.datagrams_to_send(local_ns):
            node.datagrams += 1
            cross = self._to_leader if address in node.parents else self._to_client
            for delay_ns in cross(node.rng):
                self._push(true_ns + delay_ns, self.nodes[address], outgoing, node.address)
        due_ns = engine.next_timer()
        if due_ns is None or (due_ns == node.due_ns and node.timer_true_ns > true_ns):
            return
        node.due_ns = due_ns
        timer_true_ns = max(node.clock.true_from_local(due_ns), true_ns) + 1
        if timer_true_ns != node.timer_true_ns:
            # The one before it is passed over when its time comes.
            node.timer_true_ns = timer_true_ns
            self._push(timer_true_ns, node, None, node.address)


def run_share(spec: TreeSpec, seed: int, share: int, shares: int) -> TreeResult:
    """Simulate one share of a tree."""
    began_s = process_time()
    result = Tree(spec, seed=seed, share=share, shares=shares).measure()
    result.processor_s = process_time() - began_s
    return result
