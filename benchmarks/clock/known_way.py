"""What a panel shows of a link whose two ways differ, and what is left of that after a restart.

Real processes in network namespaces: a leader with a simulated camera beside it, and one over an emulated
link. Both see the LED panel. Bursts are held against the truth before `cameras calibrate-time --panel`, after
it, and once the far node was started anew. Needs Linux and root.
"""

import argparse
import contextlib
import os
import sys
import time
from pathlib import Path
from statistics import fmean
from typing import Any

from benchmarks.clock.reference_broadcast import TAILS_US
from benchmarks.emulated_link.delays import Delays, EmulatedLink
from benchmarks.emulated_link.network import CAPTURE_APP, Network, read_output, running
from benchmarks.report import new_parser, print_circumstances, print_report, print_rows, talk
from capture_app.session.reading.reader import Session

PORT, ADDRESS = 47010, "10.77.0.1"
LEADER = ("--leader", f"{ADDRESS}:{PORT}")
CAMERA = ("--camera", "sim:phone-a,scene=led-panel,drops=0", "--tolerance-us", "2000")
SETTLE_S, EVERY_S = 15.0, 3.0


def main() -> int:
    """Print the table; 0 if all bars hold once the link is known, 1 if not."""
    parser = new_parser(__doc__, seed_of="the delays")
    parser.add_argument("--least-us", type=float, nargs=2, default=(1200.0, 400.0), help="there, back")
    parser.add_argument("--bursts", type=int, default=5, help="bursts of each part (5)")
    options = parser.parse_args()
    with Network() as network:
        report = _measure(network, options)
    print_report(report, _print, as_json=options.json)
    known = [row for name, row in report["parts"].items() if name != "before"]
    return 0 if all(row["stated_95_held"] == row["images"] for row in known) else 1


def _measure(network: Network, options: argparse.Namespace) -> dict[str, Any]:
    leader, far = network.namespace("leader"), network.namespace("far")
    ends = network.link_end(leader, f"{ADDRESS}/24"), network.link_end(far, "10.77.0.2/24")
    ways = (Delays(least, least + tail) for least, tail in zip(options.least_us, TAILS_US, strict=True))
    network.keep_user_files()
    sessions, parts = network.scratch / "sessions", {}

    def burst() -> Path:
        time.sleep(EVERY_S)
        ready = ("--frames", "3", "--wait-s", "60", "--min-nodes", "2", "--json")
        read_output(leader, *CAPTURE_APP, "burst", *LEADER, *ready)
        return max(sessions.glob("burst-*"))

    def judge(name: str) -> None:
        talk(f"{name} ...")
        parts[name] = _figures([burst() for _ in range(options.bursts)])

    node = (*CAPTURE_APP, "node", *CAMERA, "--name")
    with (
        network.emulation([EmulatedLink(*ends, *ways)], options.seed) as links,
        contextlib.ExitStack() as stack,
    ):
        lead = ("leader", "--port", str(PORT), "--sessions", str(sessions))
        stack.enter_context(running(leader, *CAPTURE_APP, *lead))
        time.sleep(EVERY_S)
        beside = ("near", "--leader", f"127.0.0.1:{PORT}", "--clock", "sim:offset_s=3600,skew_ppm=12")
        stack.enter_context(running(leader, *node, *beside))
        over_the_link = (*node, "far", *LEADER, "--clock", "sim:offset_s=7200,skew_ppm=-30")
        with running(far, *over_the_link):
            time.sleep(SETTLE_S)
            judge("before")
            measure = ("cameras", "calibrate-time", "--panel", *LEADER)
            told = read_output(leader, *CAPTURE_APP, *measure)
            judge("after")
        with running(far, *over_the_link):
            time.sleep(SETTLE_S)
            judge("restarted")
    kind = "emulated link, real processes, simulated cameras, panel and clocks"
    load = os.getloadavg()[0]
    return {"kind": kind, "told": told, "parts": parts, "links": links, "load_average": load}


def _figures(folders: list[Path]) -> dict[str, float]:
    """Errors in us of the far camera's times."""
    errors_us, stated_us, bounds_us = [], [], []
    for folder in folders:
        session = Session.open(folder)
        truth = session.true_times()
        assert truth is not None
        for image in session.manifest.images:
            if image.camera == "far":
                assert image.local_ns is not None
                true_ns = truth.clocks["far"].true_from_local(image.local_ns)
                errors_us.append(abs(image.leader_ns - true_ns) / 1000)
                stated_us.append((image.uncertainty_ns or 0) / 1000)
                bounds_us.append((image.hard_bound_ns or 0) / 1000)
    return {
        "images": len(errors_us),
        "mean_us": fmean(errors_us),
        "max_us": max(errors_us),
        "stated_95_us": fmean(stated_us),
        "stated_95_held": sum(error <= bar for error, bar in zip(errors_us, stated_us, strict=True)),
        "bound_us": fmean(bounds_us),
        "bound_held": sum(error <= bar for error, bar in zip(errors_us, bounds_us, strict=True)),
    }


COLUMNS = {
    "name": ("far camera's clock, us", ""),
    "images": ("images", ""),
    "mean_us": ("mean error", ".1f"),
    "max_us": ("largest", ".1f"),
    "stated_95_us": ("95 %", ".1f"),
    "stated_95_held": ("held", ""),
    "bound_us": ("bound", ".1f"),
    "bound_held": ("held", ""),
}


def _print(report: dict[str, Any]) -> None:
    print(f"{report['kind']}\n{report['told']}")
    print_rows([{"name": name, **row} for name, row in report["parts"].items()], COLUMNS)
    print_circumstances(report)


if __name__ == "__main__":
    sys.exit(main())
