"""A sealed leader and clients without a network: what one sends the other takes in, or a test does."""

import random
from collections.abc import Callable
from dataclasses import dataclass

from capture_app.common.node_state import NodeState
from capture_app.sync.rig.client import Client, ClientConfig
from capture_app.sync.rig.failover import Failover
from capture_app.sync.rig.leader_engine import Leader, LeaderConfig
from capture_app.sync.wire.datagrams import Principal
from capture_app.trust.datagram_keys import Address
from capture_app.trust.sealed_engines import SealedClient, SealedLeader
from tests.facts import make_facts

MS = 1_000_000
LEADER: Address = ("leader", 1)
Tamper = Callable[[bytes, Address, Address], list[tuple[bytes, Address, Address]]]
"""What becomes of a datagram on its way: bytes, from, to."""


@dataclass
class Node:
    """A client, its key, and where it is."""

    name: str
    address: Address
    client: Client[int]
    sealed: SealedClient
    principal: Principal


class SealedRig:
    """A leader and clients on one path, on which whoever holds `tamper` sits; all clocks are the same."""

    def __init__(self, *names: str, seed: int = 1) -> None:
        self.now_ns = 1_000 * MS
        self.engine = Leader(LeaderConfig(instance=5, transfer_port=47010), random.Random(seed))
        self.leader = SealedLeader(self.engine)
        self.tamper: Tamper = lambda data, sender, to: [(data, sender, to)]
        self.nodes = {name: self._new_node(name, number) for number, name in enumerate(names)}

    def _new_node(self, name: str, number: int) -> Node:
        config = ClientConfig(name, 100 + number, make_facts(), 100_000)
        client: Client[int] = Client(config, random.Random(number))
        sealed = SealedClient(Failover(client, (LEADER,)))
        principal = Principal(name, 100 + number, pin=f"pin of {name}")
        sealed.leader_keys.hold(LEADER, self.leader.keys.grant(principal))
        return Node(name, (name, 2), client, sealed, principal)

    def run(self, ms: int) -> None:
        """Let that much time pass; datagrams take a millisecond."""
        for _ in range(ms):
            self.now_ns += MS
            sent = [(d, LEADER, to) for d, to in self.leader.datagrams_to_send(self.now_ns)]
            for node in self.nodes.values():
                if self.now_ns >= node.sealed.next_timer():
                    node.sealed.handle_timer(self.now_ns)
                sent += [(d, node.address, to) for d, to in node.sealed.datagrams_to_send(self.now_ns)]
            due_ns = self.leader.next_timer()
            if due_ns is not None and self.now_ns >= due_ns:
                self.leader.handle_timer(self.now_ns)
            for datagram in sent:
                for data, sender, to in self.tamper(*datagram):
                    self.deliver(data, sender, to)

    def deliver(self, data: bytes, sender: Address, to: Address) -> None:
        """Let a datagram arrive, as if it came from there."""
        if to == LEADER:
            self.leader.receive_datagram(data, sender, self.now_ns)
        for node in self.nodes.values():
            if to == node.address:
                node.sealed.receive_datagram(data, sender, self.now_ns)

    @property
    def joined(self) -> list[str]:
        """Who is here, as the leader sees it."""
        views = self.engine.roster.by_name()
        return [view.name for view in views if view.report.state is not NodeState.LOST]


def running(*names: str) -> SealedRig:
    """A rig of these nodes that have joined and have the leader's time."""
    rig = SealedRig(*names)
    rig.run(1500)
    assert rig.joined == [*names]
    assert all(node.client.time_map is not None for node in rig.nodes.values())
    list(rig.leader.datagrams_to_send(rig.now_ns))
    return rig
