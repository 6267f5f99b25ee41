"""A rig of five with two fast clocks, each node behind an emulated wireless link (`make bench NAME=rig`).

Real processes in network namespaces, but simulated cameras and simulated clocks: two run 130 and 200 ppm
fast, as a virtual machine's or a slewed one does. Bursts are held against the truth: how far is each picture
from the instant that was asked for, and do the bounds of its time hold? Needs Linux and root.
"""

import argparse
import contextlib
import json
import os
import sys
import time
from pathlib import Path
from statistics import fmean
from typing import Any

from benchmarks.clock.clock_errors import error_figures, read_clock_errors, take_burst
from benchmarks.emulated_link.delays import EmulatedLink
from benchmarks.emulated_link.network import CAPTURE_APP, Network, read_output, running
from benchmarks.report import new_parser, print_circumstances, print_report, print_rows, print_targets, talk

PORT = 47010
SPREAD_S = 3600.0
"""Difference of consecutive clocks' offsets, s."""
NODES = {
    "cam01": ("sim:pi", -35.0),
    "cam02": ("sim:phone-a", 12.0),
    "cam03": ("sim:phone-b", 40.0),
    "fast1": ("sim:phone-a", 130.0),
    "fast2": ("sim:pi", 200.0),
}
"""Each node's camera, and its clock's skew in ppm."""
TARGET_US = 150.0
"""Maximum allowed time between an image and its instant."""


def main() -> int:
    """Take the bursts and print the errors; return 0 if all targets are met, else 1."""
    parser = new_parser(__doc__, seed_of="the emulated links")
    parser.add_argument("--bursts", type=int, default=20, help="bursts (20)")
    parser.add_argument("--frames", type=int, default=3, help="frames of each burst (3)")
    parser.add_argument("--every-s", type=float, default=5.0, help="seconds between two bursts (5)")
    options = parser.parse_args()
    with Network() as network:
        report = _measure(network, options)
    print_report(report, _print, as_json=options.json)
    return 0 if all(verdict["met"] for verdict in report["targets"]) else 1


def _measure(network: Network, options: argparse.Namespace) -> dict[str, Any]:
    leader = network.namespace("leader")
    places = {name: network.namespace(name) for name in NODES}
    links = [
        EmulatedLink(network.link_end(leader, f"10.77.{k}.1/24"), network.link_end(place, f"10.77.{k}.2/24"))
        for k, place in enumerate(places.values())
    ]
    network.keep_user_files()
    sessions = network.scratch / "sessions"
    with network.emulation(links, options.seed) as link_reports, contextlib.ExitStack() as stack:
        began_s = time.monotonic()
        lead = (*CAPTURE_APP, "leader", "--port", str(PORT), "--sessions", str(sessions))
        stack.enter_context(running(leader, *lead))
        time.sleep(2.0)
        for k, (name, (camera, skew_ppm)) in enumerate(NODES.items()):
            node = (
                "--name",
                name,
                "--leader",
                f"10.77.{k}.1:{PORT}",
                "--camera",
                f"{camera},drops=0,scale=0.25",
            )
            clock = ("--clock", f"sim:offset_s={SPREAD_S * (k + 1)},skew_ppm={skew_ppm}")
            stack.enter_context(running(places[name], *CAPTURE_APP, "node", *node, *clock))
        told = []
        for number in range(options.bursts):
            talk(f"burst {number + 1} of {options.bursts} ...")
            take_burst(leader, f"10.77.0.1:{PORT}", nodes=len(NODES), frames=options.frames, wait_s=60)
            told.append(
                json.loads(
                    read_output(leader, *CAPTURE_APP, "status", "--leader", f"10.77.0.1:{PORT}", "--json")
                )
            )
            if number == 0:
                talk(f"the first one after {time.monotonic() - began_s:.0f} s; {told[0]['advice']}")
            time.sleep(options.every_s)
    nodes = _errors(sessions, told)
    expected = options.bursts * options.frames * len(NODES)
    return {
        "kind": "emulated links, real processes, simulated cameras and clocks",
        "seed": options.seed,
        "bursts": options.bursts,
        "nodes": nodes,
        "advice": sorted({status["advice"] for status in told}),
        "targets": _verdicts(nodes, expected),
        "links": link_reports,
        "load_average": os.getloadavg()[0],
    }


def _errors(sessions: Path, told: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return each node's errors against the truth, and how often it was ready after a burst."""
    seen = read_clock_errors(sorted(sessions.glob("burst-*")))
    states = [{node["name"]: node["state"] for node in status["nodes"]} for status in told]
    nodes = {}
    for name, (camera, skew_ppm) in NODES.items():
        if errors := seen.get(name):
            clock = error_figures(errors)
            nodes[name] = {
                "skew_ppm": skew_ppm,
                "camera": camera,
                "ready": sum(state[name] == "ready" for state in states),
                "total_mean_us": fmean(abs(error.late_us) for error in errors),
                "total_max_us": max(abs(error.late_us) for error in errors),
                "clock_mean_us": clock.pop("mean_abs_us"),
                "clock_max_us": clock.pop("max_us"),
                **clock,
            }
    return nodes


def _verdicts(nodes: dict[str, dict[str, Any]], expected: int) -> list[dict[str, Any]]:
    """Return each target with its measured value."""
    images, held = (sum(node[key] for node in nodes.values()) for key in ("images", "bound_held"))
    worst_us = max((node["total_max_us"] for node in nodes.values()), default=float("inf"))
    return [
        {
            "figure": "largest total error, us",
            "measured": worst_us,
            "target": TARGET_US,
            "met": worst_us < TARGET_US,
        },
        {"figure": "images", "measured": images, "target": expected, "met": images == expected},
        {"figure": "hard bound held", "measured": held, "target": images, "met": held == images},
    ]


COLUMNS = {
    "name": ("node", ""),
    "skew_ppm": ("clock fast, ppm", ".0f"),
    "camera": ("camera", ""),
    "images": ("images", ""),
    "total_mean_us": ("total error, us: mean", ".1f"),
    "total_max_us": ("largest", ".1f"),
    "clock_mean_us": ("clock: mean", ".1f"),
    "clock_max_us": ("largest", ".1f"),
    "stated_95_us": ("95 %", ".1f"),
    "stated_95_held": ("held", ""),
    "bound_us": ("bound", ".1f"),
    "bound_held": ("held", ""),
    "ready": ("ready after bursts", ""),
}


def _print(report: dict[str, Any]) -> None:
    print(
        f"{report['bursts']} bursts, {report['kind']}; errors of a picture's instant, and of its clock alone"
    )
    print_rows([{"name": name, **row} for name, row in report["nodes"].items()], COLUMNS)
    for advice in report["advice"]:
        print(f"advice: {advice}")
    print()
    print_targets(report["targets"])
    print_circumstances(report)


if __name__ == "__main__":
    sys.exit(main())
