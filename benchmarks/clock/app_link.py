"""Phones with the paper's Android app that follow our leader over emulated WiFi (`make bench-app`).

A real leader and stand-ins for phones as processes in network namespaces; each phone's clock runs 20 ppm
fast, and it knows no skew. What it takes for leader time is looked at ten times a second and held against the
truth. Beside it: how far off it would be at the end with the first offset that it was told, as the app's own
leader tells it once an hour. Needs Linux and root.
"""

import argparse
import contextlib
import json
import os
import subprocess
import sys
import time
from statistics import fmean
from typing import Any

from benchmarks.emulated_link.delays import EmulatedLink
from benchmarks.emulated_link.network import CAPTURE_APP, ROOT, Network, in_namespace, read_output, running
from benchmarks.report import new_parser, print_circumstances, print_report, print_rows, talk

TARGET_US = 100.0
PORT = 47010
BURST_EVERY_S = 20.0


def main() -> int:
    """Measure and print; 0 where all phones were within the target throughout, 1 if not."""
    parser = new_parser(__doc__, seed_of="the emulated links")
    parser.add_argument("--phones", type=int, default=2, help="phones, each behind a link of its own (2)")
    parser.add_argument(
        "--seconds", type=float, default=300.0, help="seconds from when a phone has the time (300)"
    )
    parser.add_argument("--skew-ppm", type=float, default=20.0, help="by how much their clocks are fast (20)")
    options = parser.parse_args()
    with Network() as network:
        report = _measure(network, options)
    print_report(report, _print, as_json=options.json)
    return 0 if report["met"] else 1


def _measure(network: Network, options: argparse.Namespace) -> dict[str, Any]:
    leader = network.namespace("leader")
    places = [network.namespace(f"phone{k}") for k in range(options.phones)]
    links = [
        EmulatedLink(network.link_end(leader, f"10.77.{k}.1/24"), network.link_end(place, f"10.77.{k}.2/24"))
        for k, place in enumerate(places)
    ]
    network.keep_user_files()
    with network.emulation(links, options.seed) as link_reports, contextlib.ExitStack() as stack:
        sessions = ("--sessions", str(network.scratch / "sessions"))
        lead = (*CAPTURE_APP, "leader", "--port", str(PORT), "--android-app", *sessions)
        stack.enter_context(running(leader, *lead, "--camera", "sim:pi,drops=0,scale=0.25"))
        time.sleep(3.0)
        phones = [_start(place, k, options) for k, place in enumerate(places)]
        told = None
        bursts = 0
        while any(phone.poll() is None for phone in phones):
            time.sleep(BURST_EVERY_S)
            if all(phone.poll() is None for phone in phones):
                talk(f"burst {bursts + 1} ...")
                ask = ("--leader", f"127.0.0.1:{PORT}")
                read_output(leader, *CAPTURE_APP, "burst", *ask, "--frames", "1", "--json")
                told = json.loads(read_output(leader, *CAPTURE_APP, "status", *ask, "--json"))
                bursts += 1
        found = [json.loads(phone.communicate()[0]) for phone in phones]
    rows = [_row(k, one, told) for k, one in enumerate(found)]
    return {
        "kind": "emulated links, real leader, stand-ins for phones with simulated clocks and sensors",
        "seed": options.seed,
        "seconds": options.seconds,
        "bursts": bursts,
        "phones": rows,
        "target_us": TARGET_US,
        "met": all(row["max_us"] < TARGET_US and not row["lapses"] for row in rows),
        "links": link_reports,
        "load_average": os.getloadavg()[0],
    }


def _start(place: str, number: int, options: argparse.Namespace) -> subprocess.Popen[str]:
    command = (
        *(sys.executable, "-m", "benchmarks.clock.app_phone", f"10.77.{number}.2", f"10.77.{number}.1"),
        *("--seconds", str(options.seconds), "--skew-ppm", str(options.skew_ppm)),
    )
    return subprocess.Popen(in_namespace(place, *command), cwd=ROOT, stdout=subprocess.PIPE, text=True)


def _row(number: int, found: dict[str, Any], told: Any) -> dict[str, Any]:
    errors = [abs(error) for error in found["errors_us"]]
    status = {phone["address"]: phone for phone in (told or {}).get("app_phones", ())}
    stated = status.get(f"10.77.{number}.2", {}).get("uncertainty_ns")
    return {
        "phone": f"10.77.{number}.2",
        "synced_s": found["synced_s"],
        "looks": len(errors),
        "mean_us": fmean(errors),
        "max_us": max(errors),
        "stated_us": None if stated is None else stated / 1000,
        "lapses": found["lapses"],
        "pictures": len(found["pictures"]),
        "pictures_worst_us": max((abs(said - true) / 1000 for said, true in found["pictures"]), default=None),
        "told_once_us": abs(found["told_once_us"]),
    }


COLUMNS = {
    "phone": ("phone", ""),
    "synced_s": ("has the time after, s", ".1f"),
    "looks": ("looks", ""),
    "mean_us": ("error, us: mean", ".1f"),
    "max_us": ("largest", ".1f"),
    "stated_us": ("stated 95 %", ".1f"),
    "lapses": ("not synced", ""),
    "pictures": ("pictures", ""),
    "pictures_worst_us": ("worst stamp, us", ".1f"),
    "told_once_us": ("told once, at the end", ".0f"),
}


def _print(report: dict[str, Any]) -> None:
    print(f"{report['seconds']:.0f} s, {report['kind']}; what a phone takes for leader time")
    print_rows(report["phones"], COLUMNS)
    verdict = "met" if report["met"] else "NOT MET"
    print(f"{verdict}: all under {report['target_us']:.0f} us throughout")
    print_circumstances(report)


if __name__ == "__main__":
    sys.exit(main())
