"""A rig with cameras below a relay, every hop an emulated WiFi link, in namespaces (`make bench-relay`).

    leader, near  ==link==  relay, once  ==link==  far, far2       (far ones cannot reach the leader)

Bursts are taken through real processes and held against the simulated clocks' truth: how far is the root's
time off, after one link and after two? Then the relay is killed and started again. The namespaces and the
link's emulator come from `../shared/wifi-link`. Needs root.
"""

import argparse
import contextlib
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import fmean
from typing import Any

from wifi_link import ROOT, build_emulator, namespaces, running, why_not

from capture_app.clock import SimulatedClock
from capture_app.session.reading.reader import Session

LEADER, RELAY = "10.77.0.1:47010", "10.79.0.1:47010"
# Pair 0 joins the leader's namespace to the relay's; pair 1 joins a router of its own to the far nodes', and
# a bare cable the router to the relay, which passes no packet on by itself.
WIRING = (
    "ip link add rlc netns nbC0 type veth peer name rlr netns nbL1",
    "ip -n nbC0 addr add 10.79.0.1/24 dev rlc",
    "ip -n nbL1 addr add 10.79.0.2/24 dev rlr",
    "ip -n nbC0 link set rlc up",
    "ip -n nbL1 link set rlr up",
    "ip netns exec nbL1 sysctl -qw net.ipv4.ip_forward=1",
    "ip -n nbC1 route add 10.79.0.0/24 via 10.77.1.1",
    "ip -n nbC0 route add 10.77.1.0/24 via 10.79.0.2",
)
NODES = {
    "near": ("nbL0", LEADER, 0),
    "once": ("nbC0", LEADER, 1),
    "far": ("nbC1", RELAY, 2),
    "far2": ("nbC1", RELAY, 2),
}


def main() -> int:
    """Take the bursts and print the errors; 0 where every hard bound held, 1 if not, 0 where skipped."""
    options = _options()
    if reason := why_not():
        print(f"bench-relay skipped: {reason}", file=sys.stderr)
        return 0
    with tempfile.TemporaryDirectory() as scratch, namespaces(2, WIRING):
        report = _measure(Path(scratch), options)
    if options.json:
        print(json.dumps(report, indent=2))
    else:
        _print(report)
    return 0 if all(row["bound_held"] == row["images"] for row in report["nodes"].values()) else 1


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--bursts", type=int, default=40, help="bursts, some seconds apart (40)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the emulated links (1)")
    parser.add_argument("--json", action="store_true", help="print JSON")
    return parser.parse_args()


def _measure(scratch: Path, options: argparse.Namespace) -> dict[str, Any]:
    emulator = str(build_emulator(scratch))
    state = {"XDG_STATE_HOME": str(scratch), "XDG_DATA_HOME": str(scratch)}
    sessions = scratch / "sessions"
    with contextlib.ExitStack() as stack:
        stack.enter_context(running(emulator, "-n", "2", "-s", str(options.seed)))
        time.sleep(1.0)
        lead = _app("nbL0", scratch, "leader", "--sessions", str(sessions))
        stack.enter_context(running(*lead, **state))
        relay = _app("nbC0", scratch, "relay", LEADER, "--name", "relay", "--clock", "sim")
        relaying = stack.enter_context(running(*relay, **state))
        time.sleep(2.0)
        for name, (where, leader, _) in NODES.items():
            camera = ("--camera", "sim:perfect,drops=0,outliers=0", "--clock", "sim")
            node = _app(where, scratch, "node", "--name", name, "--leader", leader, *camera)
            stack.enter_context(running(*node, **state))
        for number in range(options.bursts):
            print(f"burst {number + 1} of {options.bursts} ...", file=sys.stderr)
            _burst(scratch)
            time.sleep(4.0)
        report = {"kind": "emulated link", "seed": options.seed, **_errors(sessions)}
        relaying.kill()
        time.sleep(4.0)
        began_s = time.monotonic()
        stack.enter_context(running(*relay, **state))
        healed = _burst(scratch)
        report["healed"] = {
            "images": healed["received"],
            "expected": healed["expected"],
            "seconds_from_start_to_session": round(time.monotonic() - began_s, 1),
        }
    return report


def _app(namespace: str, scratch: Path, *arguments: str) -> tuple[str, ...]:
    return ("ip", "netns", "exec", namespace, sys.executable, "-m", "capture_app.cli", *arguments)


def _burst(scratch: Path) -> dict[str, Any]:
    ask = ("burst", "--leader", LEADER, "--frames", "1", "--wait-ready", "90", "--json")
    command = _app("nbL0", scratch, *ask, "--nodes", str(len(NODES)))
    done = subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    return dict(json.loads(done.stdout))


def _errors(sessions: Path) -> dict[str, Any]:
    """Each node's errors of the root's time, in us, and those between the two nodes below the relay."""
    seen: dict[str, list[tuple[float, float, float]]] = {name: [] for name in NODES}
    for folder in sorted(sessions.glob("burst-*")):
        session = Session.open(folder)
        truth = session.true_times()
        assert truth is not None
        for image in session.manifest.images:
            told = truth.clocks[image.camera]
            clock = SimulatedClock(
                int(told["offset_ns"]), float(told["skew_ppm"]), int(told["epoch_true_ns"])
            )
            assert image.local_ns is not None
            error_us = (image.leader_ns - clock.true_from_local(image.local_ns)) / 1000
            sure_us, bound_us = (image.uncertainty_ns or 0) / 1000, (image.hard_bound_ns or 0) / 1000
            seen[image.camera].append((error_us, sure_us, bound_us))
    nodes = {
        name: {
            "links": NODES[name][2],
            "images": len(rows),
            "mean_abs_us": fmean(abs(error) for error, _, _ in rows),
            "max_us": max(abs(error) for error, _, _ in rows),
            "stated_95_us": fmean(sure for _, sure, _ in rows),
            "stated_95_held": sum(abs(error) <= sure for error, sure, _ in rows),
            "bound_us": fmean(bound for _, _, bound in rows),
            "bound_held": sum(abs(error) <= bound for error, _, bound in rows),
        }
        for name, rows in seen.items()
    }
    pairs = [abs(a[0] - b[0]) for a, b in zip(seen["far"], seen["far2"], strict=True)]
    return {"nodes": nodes, "far_pair": {"mean_abs_us": fmean(pairs), "max_us": max(pairs)}}


def _print(report: dict[str, Any]) -> None:
    heads = f"{'links':>6}{'mean':>8}{'largest':>9}{'95 %':>8}{'held':>9}{'bound':>9}{'held':>9}"
    print(f"{'error of the root time, us':28}{heads}")
    for name, row in report["nodes"].items():
        of = row["images"]
        print(
            f"{name:28}{row['links']:6}{row['mean_abs_us']:8.1f}{row['max_us']:9.1f}{row['stated_95_us']:8.1f}"
            f"{row['stated_95_held']:5}/{of:<3}{row['bound_us']:9.1f}{row['bound_held']:5}/{of:<3}"
        )
    pair, healed = report["far_pair"], report["healed"]
    print(f"{'far against far2':34}{pair['mean_abs_us']:8.1f}{pair['max_us']:9.1f}")
    print(
        f"relay killed and started again: {healed['images']} of {healed['expected']} images in a session"
        f" after {healed['seconds_from_start_to_session']} s"
    )


if __name__ == "__main__":
    sys.exit(main())
