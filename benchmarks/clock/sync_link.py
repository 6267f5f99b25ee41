"""Clock synchronization over real UDP between two processes on an emulated link (`make bench NAME=sync`).

Both ends share one kernel clock, so the truth is known. Needs Linux and root. Prints tables and the targets;
`--json` prints one object instead. `--quick` takes two minutes and judges the hard bounds only: so few trials
say little of a mean. `--connect` is the client's end, which it runs by itself.
"""

import argparse
import asyncio
import json
import os
import sys
from typing import Any

from benchmarks.emulated_link.delays import EmulatedLink
from benchmarks.emulated_link.network import CAPTURE_APP, Network, read_output, running
from benchmarks.paper.clock_estimators import estimator_family
from benchmarks.paper.result import error_figures
from benchmarks.report import new_parser, print_circumstances, print_report, print_rows, print_targets, talk
from capture_app.common.address import parse_address
from capture_app.common.clock import parse_clock
from capture_app.companions.link.link_measurement import judge, measure, sum_up

PORT = 47010
WIRELESS, CABLE = "10.77.0.1", "10.78.0.1"
QUICK_TRIALS = 12
CASES = {
    "paper": "the paper's link, 300 messages",
    "loss": "the same with 10 % loss",
    "cable": "a bare virtual cable, 300 messages",
    "minute": "the paper's link, 66 s, clock simulated 20 ppm fast",
}
MINUTE = ("--messages", "3160", "--clock", "sim:offset_s=7200,skew_ppm=20")
"""One minute at the engine's own rate."""
TARGETS: dict[str, dict[str, float]] = {
    "paper": {"mean_us": 14.0, "max_us": 60.0, "share_of_minimum": 1 / 3, "seconds": 1.1},
    "loss": {"times_paper": 1.2, "seconds": 1.3},
    "cable": {"mean_us": 1.0},
    "minute": {"mean_us": 25.0},
}


def main() -> int:
    """Run all cases and print them; return 0 if all targets are met, else 1."""
    parser = new_parser(__doc__, seed_of="the emulated link")
    parser.add_argument("--trials", type=int, default=100, help="trials of each short case (100)")
    parser.add_argument("--minute-trials", type=int, default=3, help="trials of the 66 s case (3)")
    parser.add_argument("--quick", action="store_true", help=f"{QUICK_TRIALS} trials of the short cases only")
    parser.add_argument("--connect", type=parse_address, help=argparse.SUPPRESS)
    parser.add_argument("--messages", type=int, default=300, help=argparse.SUPPRESS)
    parser.add_argument("--clock", default="host", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.connect is not None:
        print(json.dumps(asyncio.run(_synchronize(options))))
        return 0
    if options.quick:
        options.trials, options.minute_trials = QUICK_TRIALS, 0
    with Network() as network:
        cases, links = _measure_cases(network, options)
    report: dict[str, Any] = {
        "load_average": os.getloadavg()[0],
        "cases": cases,
        "targets": _verdicts(cases),
        "links": links,
    }
    print_report(report, _print, as_json=options.json)
    judged = [v for v in report["targets"] if not options.quick or v["figure"] == "hard bound held"]
    return 0 if all(verdict["met"] for verdict in judged) else 1


async def _synchronize(options: argparse.Namespace) -> dict[str, Any]:
    """Return the figures of the engine's clock, and the errors of other estimators on the same samples."""
    clock, trials = parse_clock(options.clock, node="link"), []
    errors_us: dict[str, list[float]] = {}
    async for reached in measure(
        options.connect, clock, messages=options.messages, trials=options.trials, seed=options.seed
    ):
        trials.append(judge(reached, clock))
        local_ns = max(sample.t3_ns for sample in reached.samples)
        for name, estimator in estimator_family().items():
            for sample in reached.samples:
                estimator.add(sample)
            time_map = reached.time_map if name == "ours" else estimator.time_map(local_ns)
            assert time_map is not None
            error_ns = time_map.leader_from_local(local_ns) - clock.true_from_local(local_ns)
            errors_us.setdefault(name, []).append(error_ns / 1000.0)
    figures = sum_up(trials, kind="emulated link", messages=options.messages, seed=options.seed)
    return {**figures, "errors_us": {name: error_figures(of) for name, of in errors_us.items()}}


def _measure_cases(
    network: Network, options: argparse.Namespace
) -> tuple[dict[str, dict[str, Any]], list[dict[str, Any]]]:
    """Return each case's result, and what the link did in each."""
    leader, client = network.namespace("leader"), network.namespace("client")
    network.cable(leader, f"{CABLE}/24", client, "10.78.0.2/24")
    link = EmulatedLink(network.link_end(leader, f"{WIRELESS}/24"), network.link_end(client, "10.77.0.2/24"))
    serve = (*CAPTURE_APP, "link", "--serve", f"0.0.0.0:{PORT}")

    def measure(case: str, host: str, trials: int, *more: str) -> None:
        talk(f"measuring: {CASES[case]}, {trials} trials ...")
        connect = ("--connect", f"{host}:{PORT}", "--trials", str(trials))
        output = read_output(client, sys.executable, "-m", "benchmarks.clock.sync_link", *connect, *more)
        cases[case] = dict(json.loads(output))

    cases: dict[str, dict[str, Any]] = {}
    with running(leader, *serve):
        with network.emulation([link], options.seed) as links:
            measure("paper", WIRELESS, options.trials)
        with network.emulation([link], options.seed, loss=0.1) as lossy:
            measure("loss", WIRELESS, options.trials)
        measure("cable", CABLE, options.trials)
        if options.minute_trials:
            with network.emulation([link], options.seed) as longer:
                measure("minute", WIRELESS, options.minute_trials, *MINUTE)
            lossy += longer
    return cases, links + lossy


def _verdicts(cases: dict[str, dict[str, Any]]) -> list[dict[str, Any]]:
    """Return each target with its measured value."""
    paper_us = cases["paper"]["mean_abs_us"]
    verdicts = []
    for case, result in cases.items():
        mean_us = result["mean_abs_us"]
        measured = {
            "mean_us": mean_us,
            "max_us": result["max_us"],
            "share_of_minimum": mean_us / result["errors_us"]["minimum"]["mean_abs"],
            "seconds": result["seconds_mean"],
            "times_paper": mean_us / paper_us,
        }
        for figure, target in TARGETS[case].items():
            value = measured[figure]
            verdicts.append(
                {"case": case, "figure": figure, "measured": value, "target": target, "met": value <= target}
            )
        held = result["coverage_hard_bound"]
        verdicts.append(
            {"case": case, "figure": "hard bound held", "measured": held, "target": 1.0, "met": held == 1.0}
        )
    return verdicts


ERROR_COLUMNS = {
    "name": ("error, us", ""),
    "mean_abs": ("mean", ".2f"),
    "max": ("largest", ".2f"),
    "std": ("std", ".2f"),
    "bias": ("bias", ".2f"),
    "share": ("ours/this", ".3f"),
}
VERDICT_COLUMNS = {
    "says": ("", ""),
    "case": ("case", ""),
    "figure": ("figure", ""),
    "measured": ("measured", ".3f"),
    "target": ("target", ".3f"),
}


def _print(report: dict[str, Any]) -> None:
    for case, result in report["cases"].items():
        errors_us = result["errors_us"]
        kind = "real" if case == "cable" else result["kind"]
        print(f"{CASES[case]} ({kind}, {result['trials']} trials)")
        rows = [
            {
                "name": name.replace("_", " "),
                **figures,
                "share": result["mean_abs_us"] / figures["mean_abs"],
            }
            for name, figures in errors_us.items()
        ]
        print_rows(rows, ERROR_COLUMNS)
        print(
            f"{result['seconds_mean']:.2f} s (slowest {result['seconds_max']:.2f}), 95 % held in "
            f"{100 * result['coverage_95']:.0f} %, "
            f"hard bound in {100 * result['coverage_hard_bound']:.0f} %\n"
        )
    print_targets(report["targets"], VERDICT_COLUMNS)
    print_circumstances(report)


if __name__ == "__main__":
    sys.exit(main())
