"""What seals of datagrams cost: the clock and the trigger with and without, side by side (`make bench-seal`).

Two leaders, one that seals and one that does not, and clients that join either in turns: over a bare virtual
cable, where a microsecond shows, and over an emulated WiFi link. Both ends share one kernel clock, so the
truth is known. The difference of each pair of trials is given with its standard error. Needs Linux and root.
"""

import argparse
import contextlib
import json
import os
import sys
import time
from math import sqrt
from statistics import fmean, median, stdev
from typing import Any

from benchmarks.clock.sealed_ends import OPEN_PORT, SEALED_PORT
from benchmarks.emulated_link.delays import EmulatedLink
from benchmarks.emulated_link.network import Network, read_output, running
from benchmarks.report import new_parser, print_report, print_rows, talk
from capture_app.sync.wire.codec import encode
from capture_app.sync.wire.messages import TimeRequest
from capture_app.trust.sealing import KEY_BYTES, OVERHEAD_BYTES, Seal, Side

CABLE, WIRELESS = "10.78.0.1", "10.77.0.1"
HOSTS = {"cable": CABLE, "emulated WiFi": WIRELESS}
ENDS = (sys.executable, "-m", "benchmarks.clock.sealed_ends")
WORST_COST = 1.1
"""The mean error of the clock with seals may be so many times that without, or within two standard errors."""
MICRO_ROUNDS = 20_000
BIG_BYTES = 1_000


def main() -> int:
    """Measure and print; 0 if the sealed clock is no worse and all bounds held, 1 if not."""
    parser = new_parser(__doc__, seed_of="the emulated link")
    parser.add_argument("--trials", type=int, default=50, help="trials with and without seals (50)")
    options = parser.parse_args()
    time_bytes = len(encode(TimeRequest(1, 2, 3)))
    costs = [_cost("a time message", time_bytes), _cost("a large message", BIG_BYTES)]
    report: dict[str, Any] = {"datagrams": costs}
    with Network() as network:
        report["cases"] = _measure(network, options)
    report["overhead_bytes"] = OVERHEAD_BYTES
    report["load_average"] = os.getloadavg()[0]
    print_report(report, _print, as_json=options.json)
    return 0 if all(case["no_worse"] and case["bounds_held"] for case in report["cases"]) else 1


def _cost(what: str, size: int) -> dict[str, Any]:
    """Time one seal and its opening, in us; the least of several rounds, which other work does not touch."""
    key, message = bytes(KEY_BYTES), bytes(size)
    least = {"seal_us": 1e9, "open_us": 1e9}
    for _ in range(5):
        one = Seal(1, key, seals=Side.CLIENT, opens=Side.LEADER)
        other = Seal(1, key, seals=Side.LEADER, opens=Side.CLIENT)
        began = time.perf_counter_ns()
        sealed = [one.seal(message) for _ in range(MICRO_ROUNDS)]
        between = time.perf_counter_ns()
        for data in sealed:
            other.open(data)
        ended = time.perf_counter_ns()
        least["seal_us"] = min(least["seal_us"], (between - began) / MICRO_ROUNDS / 1000)
        least["open_us"] = min(least["open_us"], (ended - between) / MICRO_ROUNDS / 1000)
    return {"what": what, "bytes": size, **least}


def _measure(network: Network, options: argparse.Namespace) -> list[dict[str, Any]]:
    leader, client = network.namespace("leader"), network.namespace("client")
    network.cable(leader, f"{CABLE}/24", client, "10.78.0.2/24")
    link = EmulatedLink(network.link_end(leader, f"{WIRELESS}/24"), network.link_end(client, "10.77.0.2/24"))
    trials = ("--trials", str(options.trials))
    cases = []
    for case, host in HOSTS.items():
        talk(f"measuring: {case}, {options.trials} trials with and without seals ...")
        files = {name: network.scratch / f"{name}.json" for name in ("open", "sealed")}
        with contextlib.ExitStack() as stack:
            stack.enter_context(network.emulation([link], options.seed))
            for name, port in (("open", OPEN_PORT), ("sealed", SEALED_PORT)):
                flag = ("--sealed",) if name == "sealed" else ()
                words = (*ENDS, "leader", str(port), *trials, "--out", str(files[name]), *flag)
                stack.enter_context(running(leader, *words))
            time.sleep(2.0)
            found = json.loads(read_output(client, *ENDS, "client", host, *trials))
        told = {name: json.loads(file.read_text()) for name, file in files.items()}
        cases.append(_compared(case, found, told))
    return cases


def _compared(case: str, found: dict[str, Any], told: dict[str, Any]) -> dict[str, Any]:
    """Return the figures of both sides, and the difference of their errors."""
    sides = {name: _figures(name, found[name], told[name]["trigger_us"]) for name in ("open", "sealed")}
    pairs = list(zip(found["sealed"], found["open"], strict=True))
    differences = [abs(sealed["error_us"]) - abs(plain["error_us"]) for sealed, plain in pairs]
    doubt_us = stdev(differences) / sqrt(len(differences)) if len(differences) > 1 else float("inf")
    difference_us = fmean(differences)
    return {
        "case": case,
        "kind": "real UDP over a virtual cable" if case == "cable" else "emulated link",
        "sides": list(sides.values()),
        "difference_us": difference_us,
        "standard_error_us": doubt_us,
        "no_worse": sides["sealed"]["error_us"] <= WORST_COST * sides["open"]["error_us"]
        or difference_us <= 2 * doubt_us,
        "bounds_held": all(side["bounds_held"] == 1.0 for side in sides.values()),
    }


def _figures(name: str, trials: list[dict[str, Any]], trigger_us: list[float]) -> dict[str, Any]:
    errors = [abs(trial["error_us"]) for trial in trials]
    return {
        "name": name,
        "error_us": fmean(errors),
        "largest_us": max(errors),
        "bias_us": fmean(trial["error_us"] for trial in trials),
        "hard_bound_us": fmean(trial["hard_bound_us"] for trial in trials),
        "bounds_held": fmean(abs(trial["error_us"]) <= trial["hard_bound_us"] for trial in trials),
        "round_trip_us": median(trial["round_trip_us"] for trial in trials),
        "trigger_us": median(trigger_us),
        "triggers": len(trigger_us),
    }


SIDE_COLUMNS = {
    "name": ("datagrams", ""),
    "error_us": ("mean error, us", ".2f"),
    "largest_us": ("largest", ".2f"),
    "bias_us": ("bias", ".2f"),
    "hard_bound_us": ("hard bound", ".1f"),
    "bounds_held": ("it held", ".0%"),
    "round_trip_us": ("least round trip", ".1f"),
    "trigger_us": ("trigger and its answer", ".0f"),
    "triggers": ("triggers", ""),
}
COST_COLUMNS = {
    "what": ("cost of", ""),
    "bytes": ("bytes", ""),
    "seal_us": ("seal, us", ".2f"),
    "open_us": ("open, us", ".2f"),
}


def _print(report: dict[str, Any]) -> None:
    for case in report["cases"]:
        print(f"{case['case']} ({case['kind']}); times in us, those of triggers are medians")
        print_rows(case["sides"], SIDE_COLUMNS)
        verdict = "no worse" if case["no_worse"] else "WORSE"
        difference = f"{case['difference_us']:+.2f} +- {case['standard_error_us']:.2f} us"
        print(f"sealed against open: {difference}: {verdict}\n")
    print_rows(report["datagrams"], COST_COLUMNS)
    print(f"a seal adds {report['overhead_bytes']} bytes; load {report['load_average']:.1f}")


if __name__ == "__main__":
    sys.exit(main())
