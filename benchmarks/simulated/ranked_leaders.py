"""Ranked leaders in virtual time, each as a process runs it."""

import random
from dataclasses import dataclass, field

from benchmarks.simulated.changing_clocks import WanderingClock
from benchmarks.simulated.clock_tree import Tree
from capture_app.sync.rig.leader_engine import Leader, LeaderConfig
from capture_app.sync.sync_engine import Address
from capture_app.sync.tree.succession import Succession
from capture_app.sync.wire.codec import FromClient, decode


@dataclass
class Machine:
    """A ranked leader as a process runs it: its succession, and while it leads a leader in that time."""

    name: str
    others: tuple[Address, ...]
    rank: int
    run: int = 0
    deaf_to: set[str] = field(default_factory=set)
    leader: Leader | None = None
    clock: WanderingClock = field(init=False)

    def __post_init__(self) -> None:
        self.rng = random.Random(f"{self.name} {self.run}")
        self.succession = Succession(
            f"leader-{self.name}", self.rng.getrandbits(32), self.others, self.rank, self.rng
        )

    def leader_ns(self, local_ns: int) -> int:
        """Return the reading of its leader clock at a local time, in ns."""
        continued = self.succession.continued
        return local_ns if continued is None else continued.time_map.leader_from_local(local_ns)

    def local_ns(self, leader_ns: int) -> int:
        """Return the local time of a reading; the inverse of `leader_ns`."""
        continued = self.succession.continued
        return leader_ns if continued is None else continued.time_map.local_from_leader(leader_ns)

    def receive_datagram(self, data: bytes, address: Address, now_ns: int) -> None:
        """Process one datagram of a client or of another leader."""
        if address[0] in self.deaf_to:
            return
        message = decode(data)
        if not isinstance(message, FromClient):
            self.succession.receive_datagram(data, address, now_ns)
        elif self.leader is not None:
            self.leader.receive_datagram(data, address, self.leader_ns(now_ns))
        self._look()

    def handle_timer(self, now_ns: int) -> None:
        """Run the timers that are due."""
        self.succession.handle_timer(now_ns)
        self._look()
        if self.leader is not None:
            self.leader.handle_timer(self.leader_ns(now_ns))

    def next_timer(self) -> int:
        """Return when to call `handle_timer`."""
        due_ns = None if self.leader is None else self.leader.next_timer()
        own_ns = self.succession.next_timer()
        return own_ns if due_ns is None else min(own_ns, self.local_ns(due_ns) + 1)

    def datagrams_to_send(self, now_ns: int) -> list[tuple[bytes, Address]]:
        """Return the datagrams that are due, stamped with `now_ns`."""
        led = [] if self.leader is None else self.leader.datagrams_to_send(self.leader_ns(now_ns))
        return led + self.succession.datagrams_to_send(now_ns)

    def leave(self) -> None:
        """Stop in order: say goodbye with the next datagrams."""
        if self.leader is not None:
            self.leader.leave()

    def _look(self) -> None:
        if self.succession.leads is (self.leader is not None):
            return
        self.leader, continued = None, self.succession.continued
        if self.succession.leads:
            told = (None, None) if continued is None else (continued.upstream_map, continued.grid)
            config = LeaderConfig(self.rng.getrandbits(32), 0, continues=told[0], grid=told[1])
            self.leader = Leader(config, self.rng)


def add_leaders(tree: Tree, names: str) -> dict[str, Machine]:
    """Add machines with one-letter names to a tree, the best first."""
    addresses, machines = tuple((name, 0) for name in names), {}
    for rank, name in enumerate(names):
        others = tuple(address for address in addresses if address[0] != name)
        machine = machines[name] = Machine(name, others, rank)
        machine.clock = tree.add(name, machine, machine.rng, others)
    return machines
