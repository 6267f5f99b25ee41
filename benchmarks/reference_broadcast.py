"""Reference broadcast between real processes: a leader and three nodes in network namespaces on one bridge.

Beacons are real multicast over the bridge. All that goes to one address only passes a proxy that delays it,
with a different asymmetry for each node. All namespaces share one kernel clock, so the truth is known: every
offset should be 0. Needs root. Prints a table; `--json` prints one object instead.
"""

import argparse
import asyncio
import contextlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from typing import Any

from capture_app.errors import SimulshotError
from capture_app.net.address import Address
from capture_app.node.leader.control import ask_status

ROOT = Path(__file__).resolve().parents[1]
PREFIX = "rb"
PORT = 47010
LEADER, NODE, PROXY = "10.79.0.1", "10.79.0.1{}", "10.79.0.2{}"
CAPTURE_APP = (sys.executable, "-m", "capture_app.cli")
TAILS_US = (1399, 616)
"""Mean delay beyond the least, to the leader and from it, as on the paper's link; Gamma of shape 2."""
LINKS = {
    "own asymmetries": ((400, 800), (479, 517), (800, 400)),
    "all alike": ((479, 517),) * 3,
}
"""Least delay in us to the leader and from it, of each node."""
SETTLED_S = 20.0
TARGET_SHARE = 0.25
"""Nodes with asymmetries of their own should be no further apart than this share of what they were."""


def main() -> int:
    """Run both cases; 0 if agreement brings nodes nearer and no bound broke, 1 if not, 0 where skipped."""
    options = _options()
    if options.poll is not None:
        return asyncio.run(_poll(options.poll))
    reason = _why_not()
    if reason:
        print(f"bench-reference skipped: {reason}", file=sys.stderr)
        return 0
    results = {}
    for name, links in LINKS.items():
        print(f"measuring: {name}, {options.seconds:g} s ...", file=sys.stderr)
        with _namespaces(len(links)):
            results[name] = _figures(_measure(links, options))
    report = {"kind": "emulated link", "load_average": os.getloadavg()[0], "cases": results}
    if options.json:
        print(json.dumps(report, indent=2))
    else:
        _print(report)
    return 0 if all(case["met"] for case in results.values()) else 1


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=60.0, help="length of each case (60)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the delays (1)")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--poll", type=float, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if not SETTLED_S + 10.0 <= options.seconds <= 600.0:
        parser.error(f"{SETTLED_S + 10.0:g} to 600 seconds")
    return options


def _why_not() -> str:
    if not sys.platform.startswith("linux") or os.geteuid() != 0:
        return "network namespaces need Linux and root"
    if shutil.which("ip") is None:
        return "ip (iproute2) is not installed"
    probe = subprocess.run(["ip", "netns", "add", f"{PREFIX}B"], capture_output=True, text=True, check=False)
    if probe.returncode:
        return f"no network namespaces here: {probe.stderr.strip()}"
    bridge = _ip("-n", f"{PREFIX}B", "link", "add", "probe", "type", "bridge", check=False)
    _ip("netns", "del", f"{PREFIX}B")
    return "" if bridge == 0 else "this kernel has no bridge"


def _ip(*arguments: str, check: bool = True) -> int:
    return subprocess.run(["ip", *arguments], check=check, stderr=subprocess.DEVNULL).returncode


@contextlib.contextmanager
def _namespaces(nodes: int) -> Iterator[None]:
    """A bridge, with the leader, the proxies and the nodes on it, each in a namespace of its own."""
    homes = {"L": (LEADER,), "P": tuple(PROXY.format(k) for k in range(nodes))}
    homes |= {str(k): (NODE.format(k),) for k in range(nodes)}
    bridge = f"{PREFIX}B"
    try:
        for name in ("B", *homes):
            _ip("netns", "del", PREFIX + name, check=False)
            _ip("netns", "add", PREFIX + name)
        _ip("-n", bridge, "link", "add", "br0", "type", "bridge", "mcast_snooping", "0")
        _ip("-n", bridge, "link", "set", "br0", "up")
        for name, addresses in homes.items():
            there = PREFIX + name
            _ip(
                "-n",
                bridge,
                "link",
                "add",
                f"v{name}",
                "type",
                "veth",
                "peer",
                "name",
                "eth0",
                "netns",
                there,
            )
            _ip("-n", bridge, "link", "set", f"v{name}", "master", "br0", "up")
            for address in addresses:
                _ip("-n", there, "addr", "add", f"{address}/24", "dev", "eth0")
            _ip("-n", there, "link", "set", "eth0", "up")
            _ip("-n", there, "link", "set", "lo", "up")
        yield
    finally:
        for name in ("B", *homes):
            _ip("netns", "del", PREFIX + name, check=False)


@contextlib.contextmanager
def _running(name: str, *command: str) -> Iterator[None]:
    process = subprocess.Popen(
        ("ip", "netns", "exec", PREFIX + name, *command),
        cwd=ROOT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield
    finally:
        process.terminate()
        process.wait(timeout=20)


def _measure(links: tuple[tuple[int, int], ...], options: argparse.Namespace) -> list[dict[str, Any]]:
    """Run the product's own commands, and return what the leader says of its nodes each half second."""
    this = (sys.executable, __file__, "--seed", str(options.seed))
    with tempfile.TemporaryDirectory() as scratch, contextlib.ExitStack() as running:
        start = running.enter_context
        ways = [
            f"{PROXY.format(k)}:{there_us + TAILS_US[0]}/{there_us},{back_us + TAILS_US[1]}/{back_us}"
            for k, (there_us, back_us) in enumerate(links)
        ]
        proxy = (sys.executable, str(Path(__file__).with_name("delay_proxy.py")))
        start(_running("P", *proxy, "--seed", str(options.seed), f"{LEADER}:{PORT}", *ways))
        sessions = ("--sessions", f"{scratch}/sessions", "--spool", f"{scratch}/spool")
        start(_running("L", *CAPTURE_APP, "leader", "--port", str(PORT), "--reference-broadcast", *sessions))
        for k in range(len(links)):
            camera = ("--name", f"node{k}", "--camera", "sim:perfect", "--tolerance-us", "5000")
            leader = ("--leader", f"{PROXY.format(k)}:{PORT}", "--spool", f"{scratch}/spool{k}")
            start(_running(str(k), *CAPTURE_APP, "node", *camera, *leader))
        poll = ("ip", "netns", "exec", f"{PREFIX}L", *this, "--poll", str(options.seconds))
        done = subprocess.run(poll, cwd=ROOT, check=True, stdout=subprocess.PIPE)
    return [json.loads(line) for line in done.stdout.splitlines()]


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
                print("the nodes do not join", file=sys.stderr)
                return 1
            continue
        began_s = began_s or time.monotonic()
        line = {
            node.name: {
                "offset_ns": node.offset_ns,
                "moved_ns": node.moved_ns,
                "apart_ns": node.apart_ns,
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
        {name: (n["offset_ns"] - (n["moved_ns"] or 0)) / 1e3 for name, n in nodes.items()}
        for nodes in settled
    ]
    every = [node for nodes in settled for node in nodes.values()]
    in_use = [node for node in every if node["moved_ns"] is not None]
    pairs = {"with": _pairs(agreed), "without": _pairs(alone)}
    held = sum(abs(node["offset_ns"]) <= node["hard_bound_ns"] for node in every) / len(every)
    nearer = pairs["with"]["mean_abs"] <= TARGET_SHARE * pairs["without"]["mean_abs"]
    return {
        "between_nodes_us": pairs,
        "to_leader_us": {"with": _sizes(agreed), "without": _sizes(alone)},
        "in_use_share": len(in_use) / len(every),
        "apart_us_mean": sum(n["apart_ns"] for n in in_use) / 1e3 / len(in_use) if in_use else None,
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


def _print(report: dict[str, Any]) -> None:
    for name, case in report["cases"].items():
        print(f"{name} (emulated link, {case['moments']} moments after {SETTLED_S:g} s)")
        print(f"  {'error, us':28}{'mean abs':>10}{'99 %':>10}{'largest':>10}")
        for title, key in (("between nodes", "between_nodes_us"), ("to the leader", "to_leader_us")):
            for which in ("without", "with"):
                cells = "".join(f"{case[key][which][part]:10.1f}" for part in ("mean_abs", "p99", "max"))
                print(f"  {f'{title}, {which}':28}{cells}")
        told = "-" if case["apart_us_mean"] is None else f"{case['apart_us_mean']:.1f} us"
        print(
            f"  in use {100 * case['in_use_share']:.0f} %, said to be apart by {told}, "
            f"hard bound held in {100 * case['coverage_hard_bound']:.0f} %, "
            f"{'met' if case['met'] else 'NOT MET'}\n"
        )
    print(f"load average of the machine: {report['load_average']:.1f}")


if __name__ == "__main__":
    sys.exit(main())
