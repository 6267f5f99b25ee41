"""Reference broadcast between real processes: a leader and three nodes in network namespaces.

Each node's link to the leader is an emulated one, with an asymmetry of its own; multicast, and so every
beacon, passes a bridge instead and reaches all within microseconds. All namespaces share one kernel clock:
every offset should be 0. Needs Linux and root. Prints a table; `--json` prints one object instead.
"""

import argparse
import asyncio
import contextlib
import json
import os
import sys
import time
from itertools import combinations
from statistics import mean
from typing import Any

from benchmarks.emulated_link.delays import Delays, EmulatedLink
from benchmarks.emulated_link.network import CAPTURE_APP, Network, read_output, running
from benchmarks.report import new_parser, print_circumstances, print_report, print_rows, talk
from capture_app.common.address import Address
from capture_app.common.errors import SimulshotError
from capture_app.rig.link import ask_status

ITSELF = "benchmarks.clock.reference_broadcast"
PORT = 47010
LEADER, NODE = "10.79.0.1", "10.79.0.1{}"
TAILS_US = (1399.0, 616.0)
"""Mean delay beyond the least, to the leader and from it, Gamma of shape 2: as the paper's link has it beyond
its quickest message."""
LINKS = {
    "own asymmetries": ((400.0, 800.0), (479.0, 517.0), (800.0, 400.0)),
    "all alike": ((479.0, 517.0),) * 3,
}
"""Least delay in us to the leader and from it, of each node."""
SETTLED_S = 20.0
TARGET_SHARE = 0.25
"""Nodes with asymmetries of their own should be no further apart than this share of what they were."""


def main() -> int:
    """Run both cases; 0 if agreement brings nodes nearer and no bound broke, 1 if not."""
    parser = new_parser(__doc__, seed_of="the delays")
    parser.add_argument("--seconds", type=float, default=60.0, help="length of each case (60)")
    parser.add_argument("--poll", type=float, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if not SETTLED_S + 10.0 <= options.seconds <= 600.0:
        parser.error(f"{SETTLED_S + 10.0:g} to 600 seconds")
    if options.poll is not None:
        return asyncio.run(_poll(options.poll))
    results, links = {}, []
    for name, least_us in LINKS.items():
        talk(f"measuring: {name}, {options.seconds:g} s ...")
        with Network() as network:
            lines, reports = _measure(network, least_us, options)
        results[name] = _figures(lines)
        links += reports
    report = {"kind": "emulated link", "load_average": os.getloadavg()[0], "cases": results, "links": links}
    print_report(report, _print, as_json=options.json)
    return 0 if all(case["met"] for case in results.values()) else 1


def _measure(
    network: Network, least_us: tuple[tuple[float, float], ...], options: argparse.Namespace
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Run the product's own commands; return what the leader says of its nodes each half second.

    Returns also what the links did.
    """
    leader = network.namespace("leader")
    nodes = [network.namespace(f"node{k}") for k in range(len(least_us))]
    hub = network.multicast_hub()
    links = [
        EmulatedLink(
            network.link_end(leader),
            network.link_end(node),
            *(Delays(least, least + tail) for least, tail in zip(both, TAILS_US, strict=True)),
        )
        for node, both in zip(nodes, least_us, strict=True)
    ]
    network.join_hub(leader, f"{LEADER}/24", [link.leader for link in links], hub)
    for k, (node, link) in enumerate(zip(nodes, links, strict=True)):
        network.join_hub(node, f"{NODE.format(k)}/24", [link.client], hub)
    scratch = network.scratch
    with network.emulation(links, options.seed) as reports, contextlib.ExitStack() as processes:
        start = processes.enter_context
        sessions = ("--sessions", f"{scratch}/sessions", "--spool", f"{scratch}/spool")
        lead = (*CAPTURE_APP, "leader", "--port", str(PORT), "--reference-broadcast", *sessions)
        start(running(leader, *lead))
        for k, node in enumerate(nodes):
            camera = ("--name", f"node{k}", "--camera", "sim:perfect", "--tolerance-us", "5000")
            follow = ("--leader", f"{LEADER}:{PORT}", "--spool", f"{scratch}/spool{k}")
            start(running(node, *CAPTURE_APP, "node", *camera, *follow))
        poll = read_output(leader, sys.executable, "-m", ITSELF, "--poll", str(options.seconds))
    return [json.loads(line) for line in poll.splitlines()], reports


async def _poll(seconds: float) -> int:
    """Print a line with all nodes' clocks twice a second; the time counts from when all are synchronized."""
    began_s = None
    give_up_s = time.monotonic() + 60.0
    while began_s is None or time.monotonic() < began_s + seconds:
        await asyncio.sleep(0.5)
        try:
            rig = await ask_status(Address(LEADER, PORT))
        except SimulshotError:
            rig = None
        nodes = () if rig is None else rig.nodes
        if len(nodes) < 3 or any(node.offset_ns is None for node in nodes):
            if time.monotonic() > give_up_s:
                talk("the nodes do not join")
                return 1
            continue
        began_s = began_s or time.monotonic()
        line = {
            node.name: {
                "offset_ns": node.offset_ns,
                "reference_correction_ns": node.reference_correction_ns,
                "relative_uncertainty_ns": node.relative_uncertainty_ns,
                "hard_bound_ns": node.hard_bound_ns,
                "uncertainty_ns": node.uncertainty_ns,
            }
            for node in nodes
        }
        print(json.dumps({"at_s": time.monotonic() - began_s, "nodes": line}), flush=True)
    return 0


def _figures(lines: list[dict[str, Any]]) -> dict[str, Any]:
    """Sum up what came after the first seconds; errors in us."""
    settled = [line["nodes"] for line in lines if line["at_s"] >= SETTLED_S]
    agreed = [{name: n["offset_ns"] / 1e3 for name, n in nodes.items()} for nodes in settled]
    alone = [
        {name: (n["offset_ns"] - (n["reference_correction_ns"] or 0)) / 1e3 for name, n in nodes.items()}
        for nodes in settled
    ]
    every = [node for nodes in settled for node in nodes.values()]
    in_use = [node for node in every if node["reference_correction_ns"] is not None]
    pairs = {"with": _pairs(agreed), "without": _pairs(alone)}
    held = sum(abs(node["offset_ns"]) <= node["hard_bound_ns"] for node in every) / len(every)
    nearer = pairs["with"]["mean_abs"] <= TARGET_SHARE * pairs["without"]["mean_abs"]
    return {
        "between_nodes_us": pairs,
        "to_leader_us": {"with": _sizes(agreed), "without": _sizes(alone)},
        "in_use_share": len(in_use) / len(every),
        "relative_us_mean": mean(n["relative_uncertainty_ns"] / 1e3 for n in in_use) if in_use else None,
        "coverage_hard_bound": held,
        "moments": len(settled),
        "share": pairs["with"]["mean_abs"] / pairs["without"]["mean_abs"],
        "met": held == 1.0 and (nearer or pairs["without"]["mean_abs"] < 50.0),
    }


def _pairs(moments: list[dict[str, float]]) -> dict[str, float]:
    return _summed([abs(a - b) for errors in moments for a, b in combinations(errors.values(), 2)])


def _sizes(moments: list[dict[str, float]]) -> dict[str, float]:
    return _summed([abs(error) for errors in moments for error in errors.values()])


def _summed(sizes: list[float]) -> dict[str, float]:
    ascending = sorted(sizes)
    return {
        "mean_abs": sum(sizes) / len(sizes),
        "p99": ascending[int(0.99 * len(ascending))],
        "max": ascending[-1],
    }


COLUMNS = {
    "name": ("error, us", ""),
    "mean_abs": ("mean", ".1f"),
    "p99": ("99 %", ".1f"),
    "max": ("largest", ".1f"),
}


def _print(report: dict[str, Any]) -> None:
    for name, case in report["cases"].items():
        print(f"{name} (emulated link, {case['moments']} moments after {SETTLED_S:g} s)")
        rows = [
            {"name": f"{title}, {which}", **case[key][which]}
            for title, key in (("between nodes", "between_nodes_us"), ("to the leader", "to_leader_us"))
            for which in ("without", "with")
        ]
        print_rows(rows, COLUMNS)
        told = "-" if case["relative_us_mean"] is None else f"{case['relative_us_mean']:.1f} us"
        print(
            f"in use {100 * case['in_use_share']:.0f} %, said to be apart by {told}, "
            f"hard bound held in {100 * case['coverage_hard_bound']:.0f} %, "
            f"{'met' if case['met'] else 'NOT MET'}\n"
        )
    print_circumstances(report)


if __name__ == "__main__":
    sys.exit(main())
