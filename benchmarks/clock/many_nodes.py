"""Many nodes of one leader: their clocks on the paper's link in virtual time, and what a trigger costs.

Nodes that keep time as a camera's does start within two seconds, and are judged after two minutes. By default
ten stand for a thousand: a leader that bears 200 exchanges a second asks of them the pace that one which
bears 20,000 asks of a thousand, and no node hears the others. `--nodes 1000 --exchanges-per-s 20000` runs
all, which takes half an hour. Then what the leader's engine needs, in processor time of this machine, for
each trigger of a burst that is sent and acknowledged.
"""

import random
from argparse import Namespace
from time import process_time_ns
from typing import Any

from benchmarks.clock.many_clients import CAMERA
from benchmarks.report import new_parser, print_report, print_table
from benchmarks.simulated.clock_tree import RIG, ROOT, Tree, TreeSpec
from capture_app.common.node_state import NodeState
from capture_app.sync.rig.leader import Leader, LeaderConfig
from capture_app.sync.rig.orders import BurstOrder
from capture_app.sync.rig.time_client import TimeClient
from capture_app.sync.timekeeping.poll_schedule import AccuracyTarget
from capture_app.sync.timekeeping.timekeeper import Timekeeper
from capture_app.sync.wire.codec import decode, encode
from capture_app.sync.wire.messages import Heartbeat, Hello, Report, Trigger, TriggerAck, Welcome

NODES, EXCHANGES_PER_S = 10, 200.0
MEMBERS = (1000, 3000, 9000)
TOLERANCE_NS = 100_000
SECONDS = 120.0
LOOKS, LOOK_EVERY_S = 10, 1.0


class CameraNode:
    """The clock of a camera's node as an engine of a `Tree`."""

    def __init__(self, name: str, rng: random.Random) -> None:
        keeper = Timekeeper(rng.getrandbits(32), target=AccuracyTarget(TOLERANCE_NS))
        self.client = TimeClient(name, rng.getrandbits(32), keeper)
        self.next_timer = self.client.next_timer
        self.handle_timer = self.client.handle_timer

    def receive_datagram(self, data: bytes, address: tuple[str, int], now_ns: int) -> None:
        """Take in one datagram."""
        self.client.receive_datagram(data, now_ns)

    def datagrams_to_send(self, now_ns: int) -> list[tuple[bytes, tuple[str, int]]]:
        """Return what is due, stamped with `now_ns`."""
        return [(data, ROOT) for data in self.client.datagrams_to_send(now_ns)]


def measure_clocks(nodes: int, exchanges_per_s: float, seconds: float, seed: int) -> dict[str, Any]:
    """Compare the clocks of so many nodes with the truth after so many seconds."""
    tree = Tree(TreeSpec(0, 0, seconds), seed=seed)
    tree.nodes[ROOT].engine = tree.root = Leader(
        LeaderConfig(1, 0, RIG, exchanges_per_s=exchanges_per_s), random.Random(seed)
    )
    clients = []
    for i in range(nodes):
        rng = random.Random(f"{seed} node{i}")
        node = CameraNode(f"node{i}", rng)
        clients.append((node.client, tree.add(f"node{i}", node, rng, (ROOT,))))
    errors_us, ready, held = [], 0, 0
    for look in range(LOOKS):
        tree.run_until(round((seconds + look * LOOK_EVERY_S) * 1e9))
        for client, clock in clients:
            local_ns, time_map = clock.local_from_true(tree.now_true_ns), client.time_map
            ready += client.state is NodeState.READY and client.timekeeper.target.met
            if time_map is not None:
                error_ns = abs(time_map.leader_from_local(local_ns) - tree.now_true_ns)
                errors_us.append(error_ns / 1000.0)
                held += error_ns <= time_map.uncertainty_at(local_ns)
    return {
        "nodes": nodes,
        "pace_ms": tree.root.pace_ns / 1e6,
        "mean_us": sum(errors_us) / len(errors_us),
        "max_us": max(errors_us),
        "stated_95_held": held / len(errors_us),
        "ready": ready / (LOOKS * nodes),
        "requests_per_s": sum(client.timekeeper.requests for client, _ in clients) / tree.now_true_ns * 1e9,
    }


def measure_triggers(members: int) -> dict[str, Any]:
    """Let so many members join, order a burst, and acknowledge each of its triggers."""
    leader, now_ns = Leader(LeaderConfig(1, 0, RIG), random.Random(1)), 10**12
    for i in range(members):
        leader.receive_datagram(encode(Hello(f"cam{i}", i + 1, CAMERA)), (f"cam{i}", 0), now_ns)
    for data, address in leader.datagrams_to_send(now_ns):
        message = decode(data)
        if isinstance(message, Welcome):
            heartbeat = Heartbeat(message.client, Report(state=NodeState.READY))
            leader.receive_datagram(encode(heartbeat), address, now_ns)
    leader.datagrams_to_send(now_ns)
    began_ns = process_time_ns()
    leader.trigger(now_ns, BurstOrder(frames=5))
    leader.handle_timer(now_ns)
    answers = []
    for data, address in leader.datagrams_to_send(now_ns):
        message = decode(data)
        assert isinstance(message, Trigger)
        answers.append((encode(TriggerAck(message.client, message.leader, message.burst, "")), address))
    for data, address in answers:
        leader.receive_datagram(data, address, now_ns)
        due_ns = leader.next_timer()
        assert due_ns is not None or data is answers[-1][0]
    spent_ns = process_time_ns() - began_ns
    assert len(answers) == members
    return {"members": members, "trigger_us": spent_ns / members / 1000.0}


def main() -> None:
    """Print both tables."""
    parser = new_parser(__doc__, seed_of="links and clocks")
    parser.add_argument("--nodes", type=int, default=NODES, help=f"nodes of one leader ({NODES})")
    parser.add_argument(
        "--exchanges-per-s", type=float, default=EXCHANGES_PER_S, help=f"that it bears ({EXCHANGES_PER_S:g})"
    )
    parser.add_argument("--seconds", type=float, default=SECONDS, help=f"from the start on ({SECONDS:g})")
    options: Namespace = parser.parse_args()
    clocks = []
    if options.nodes:
        clocks.append(measure_clocks(options.nodes, options.exchanges_per_s, options.seconds, options.seed))
    report = {
        "kind": "simulated",
        "seed": options.seed,
        "clocks": clocks,
        "triggers": [measure_triggers(members) for members in MEMBERS],
    }
    print_report(report, _print, as_json=options.json)


def _print(report: dict[str, Any]) -> None:
    for rows in (report["clocks"], report["triggers"]):
        if rows:
            print_table(tuple(rows[0]), [tuple(f"{value:.4g}" for value in row.values()) for row in rows])


if __name__ == "__main__":
    main()
