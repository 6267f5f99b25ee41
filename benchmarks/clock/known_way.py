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
from typing import Any

from benchmarks.clock.clock_errors import COLUMNS, error_figures, read_clock_errors, take_burst
from benchmarks.emulated_link.delays import Delays, EmulatedLink
from benchmarks.emulated_link.network import CAPTURE_APP, Network, read_output, running
from benchmarks.report import new_parser, print_circumstances, print_report, print_rows, talk

PORT, ADDRESS = 47010, "10.77.0.1"
LEADER = ("--leader", f"{ADDRESS}:{PORT}")
CAMERA = ("--camera", "sim:phone-a,scene=led-panel,drops=0", "--tolerance-us", "2000")
SETTLE_S, EVERY_S = 15.0, 3.0
TAILS_US = (1399.0, 616.0)
"""Mean delay beyond the minimum in each direction, as on the paper's link beyond its quickest message."""


def main() -> int:
    """Print the table; return 0 if all error bars contain the truth once the asymmetry is known, else 1."""
    parser = new_parser(__doc__, seed_of="the delays")
    parser.add_argument("--min-us", type=float, nargs=2, default=(1200.0, 400.0), help="there, back")
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
    ways = (Delays(least, least + tail) for least, tail in zip(options.min_us, TAILS_US, strict=True))
    network.keep_user_files()
    sessions, parts = network.scratch / "sessions", {}

    def burst() -> Path:
        time.sleep(EVERY_S)
        take_burst(leader, LEADER[1], nodes=2, frames=3, wait_s=60)
        return max(sessions.glob("burst-*"))

    def judge(name: str) -> None:
        talk(f"{name} ...")
        taken = [burst() for _ in range(options.bursts)]
        parts[name] = error_figures(read_clock_errors(taken)["far"])

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


def _print(report: dict[str, Any]) -> None:
    print(f"{report['kind']}\n{report['told']}")
    rows = [{"name": name, **row} for name, row in report["parts"].items()]
    print_rows(rows, {"name": ("error of the far camera's clock, us", ""), **COLUMNS})
    print_circumstances(report)


if __name__ == "__main__":
    sys.exit(main())
