"""A rig with cameras below a relay, every hop an emulated wireless link (`make bench NAME=relay`).

    leader, near  ==link==  relay, once  ==link==  far, far2       (far ones cannot reach the leader)

Bursts are taken through real processes and held against the simulated clocks' truth: how far is the root's
time off, after one link and after two? Then the relay is killed and started again. Needs Linux and root.
"""

import argparse
import contextlib
import os
import sys
import time
from pathlib import Path
from statistics import fmean
from typing import Any

from benchmarks.clock.clock_errors import COLUMNS, error_figures, read_clock_errors, take_burst
from benchmarks.emulated_link.delays import EmulatedLink
from benchmarks.emulated_link.network import CAPTURE_APP, Network, running
from benchmarks.report import new_parser, print_circumstances, print_report, print_rows, talk

LEADER, RELAY = "10.77.0.1:47010", "10.79.0.1:47010"
NODES = {"near": ("top", LEADER, 0), "once": ("middle", LEADER, 1)} | dict.fromkeys(
    ("far", "far2"), ("bottom", RELAY, 2)
)
"""Each node's namespace, its leader, and the number of links between it and the root."""
BETWEEN_BURSTS_S = 4.0


def main() -> int:
    """Take the bursts and print the errors; return 0 if every hard bound held, else 1."""
    parser = new_parser(__doc__, seed_of="the emulated links")
    parser.add_argument("--bursts", type=int, default=40, help="bursts, some seconds apart (40)")
    options = parser.parse_args()
    with Network() as network:
        report = _measure(network, options)
    print_report(report, _print, as_json=options.json)
    return 0 if all(row["bound_held"] == row["images"] for row in report["nodes"].values()) else 1


def _measure(network: Network, options: argparse.Namespace) -> dict[str, Any]:
    top, middle, bottom = (network.namespace(name) for name in ("top", "middle", "bottom"))
    places = {"top": top, "middle": middle, "bottom": bottom}
    links = [
        EmulatedLink(network.link_end(top, "10.77.0.1/24"), network.link_end(middle, "10.77.0.2/24")),
        EmulatedLink(network.link_end(middle, "10.79.0.1/24"), network.link_end(bottom, "10.79.0.2/24")),
    ]
    network.keep_user_files()
    sessions = network.scratch / "sessions"
    relay = (middle, *CAPTURE_APP, "relay", LEADER, "--name", "relay", "--clock", "sim")
    with network.emulation(links, options.seed) as link_reports, contextlib.ExitStack() as stack:
        lead = (*CAPTURE_APP, "leader", "--sessions", str(sessions))
        stack.enter_context(running(top, *lead))
        relaying = stack.enter_context(running(*relay))
        time.sleep(2.0)
        for name, (place, leader, _) in NODES.items():
            camera = ("--camera", "sim:perfect,drops=0,outliers=0", "--clock", "sim")
            node = (*CAPTURE_APP, "node", "--name", name, "--leader", leader, *camera)
            stack.enter_context(running(places[place], *node))
        for number in range(options.bursts):
            talk(f"burst {number + 1} of {options.bursts} ...")
            take_burst(top, LEADER, nodes=len(NODES), frames=1, wait_s=90)
            time.sleep(BETWEEN_BURSTS_S)
        report = {"kind": "emulated link", "seed": options.seed, **_errors(sessions)}
        relaying.kill()
        time.sleep(BETWEEN_BURSTS_S)
        began_s = time.monotonic()
        stack.enter_context(running(*relay))
        healed = take_burst(top, LEADER, nodes=len(NODES), frames=1, wait_s=90)
        report["healed"] = {
            "images": healed["received"],
            "expected": healed["expected"],
            "seconds_from_start_to_session": round(time.monotonic() - began_s, 1),
        }
    return {**report, "links": link_reports, "load_average": os.getloadavg()[0]}


def _errors(sessions: Path) -> dict[str, Any]:
    """Return each node's errors of the root's time, in us, and between the two nodes below the relay."""
    seen = read_clock_errors(sorted(sessions.glob("burst-*")))
    nodes = {name: {"links": node[2], **error_figures(seen[name])} for name, node in NODES.items()}
    pairs = [abs(a.off_us - b.off_us) for a, b in zip(seen["far"], seen["far2"], strict=True)]
    return {"nodes": nodes, "far_pair": {"mean_abs_us": fmean(pairs), "max_us": max(pairs)}}


def _print(report: dict[str, Any]) -> None:
    pair, healed = report["far_pair"], report["healed"]
    rows = [{"name": name, **row} for name, row in report["nodes"].items()]
    columns = {"name": ("error of the root's time, us", ""), "links": ("links", ""), **COLUMNS}
    print_rows([*rows, {"name": "far against far2", **pair}], columns)
    print(
        f"relay killed and started again: {healed['images']} of {healed['expected']} images in a session"
        f" after {healed['seconds_from_start_to_session']} s"
    )
    print_circumstances(report)


if __name__ == "__main__":
    sys.exit(main())
