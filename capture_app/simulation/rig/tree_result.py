"""What a tree of clocks is measured by: errors against the truth, and the load on root and relays."""

from dataclasses import dataclass, field
from math import nan
from time import process_time

from capture_app.simulation.rig.tree import ROOT, Tree, TreeSpec
from capture_app.sync.tree.follower import Follower
from capture_app.sync.tree.relay import Relay


@dataclass(slots=True)
class TreeResult:
    """The measurements of a shard."""

    instants_s: list[float] = field(default_factory=list)
    errors_us: list[list[float]] = field(default_factory=list)
    """Of each client at each instant; nan where it has no time map."""
    within_95: int = 0
    """How many errors were within the stated 95 % uncertainty."""
    within_bound: int = 0
    """How many errors were within the hard bound."""
    judged: int = 0
    """How many errors there are."""
    root_datagrams: int = 0
    """That the root received or sent."""
    root_busy_ns: int = 0
    """Processor time inside the root's engine, measured on this machine."""
    processor_s: float = 0.0
    """Processor time of the whole simulation."""
    busiest_relay_datagrams: int = 0
    datagrams: int = 0
    digest: str = ""
    """Of every datagram and when it arrived: the same for the same seed."""


def measure(tree: Tree) -> TreeResult:
    """Run a tree, and compare every client's time with the truth at each sampling instant."""
    result = TreeResult()
    clients = [(node.engine, node.clock) for node in tree.nodes.values() if isinstance(node.engine, Follower)]

    def sample() -> None:
        now_true_ns, errors = tree.now_true_ns, []
        for follower, clock in clients:
            time_map = follower.time_map
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
    began_s = process_time()
    result = measure(Tree(spec, seed=seed, shard=shard, shards=shards))
    result.processor_s = process_time() - began_s
    return result
