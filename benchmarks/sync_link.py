"""Clock synchronization over real UDP between two processes, on an emulated WiFi link (`make bench-sync`).

Network namespaces and the link's emulator come from `../shared/wifi-link`; both ends share one kernel clock,
so the truth is known. Needs root. Prints a table and the ratios; `--json` prints one object instead.
"""

import argparse
import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from wifi_link import ROOT, build_emulator, namespaces, running, why_not

PORT = 47010
TAP, VETH = "10.77.{}.1", "10.78.{}.1"
CAPTURE_APP = (sys.executable, "-m", "capture_app.cli")

# What "done" means for issue 3.
TARGETS: dict[str, dict[str, float]] = {
    "paper": {"mean_us": 14.0, "max_us": 60.0, "share_of_minimum": 1 / 3, "seconds": 1.1},
    "loss": {"times_paper": 1.2, "seconds": 1.3},
    "veth": {"mean_us": 1.0},
    "minute": {"mean_us": 25.0},
}


def main() -> int:
    """Run all cases and print them; 0 if all targets are met, 1 if not, 0 with a reason where skipped."""
    options = _options()
    reason = why_not()
    if reason:
        print(f"bench-sync skipped: {reason}", file=sys.stderr)
        return 0
    pairs = max(1, min(options.minute_trials, 3))
    with tempfile.TemporaryDirectory() as scratch, namespaces(pairs):
        results = _cases(build_emulator(Path(scratch)), pairs, options)
    report: dict[str, Any] = {
        "load_average": os.getloadavg()[0],
        "cases": results,
        "targets": _verdicts(results),
    }
    if options.json:
        print(json.dumps(report, indent=2))
    else:
        _print(report)
    return 0 if all(verdict["met"] for verdict in report["targets"]) else 1


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--trials", type=int, default=100, help="trials of each short case (100)")
    parser.add_argument("--minute-trials", type=int, default=3, help="trials of the 66 s case (3)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the emulated link (1)")
    parser.add_argument("--json", action="store_true", help="print JSON")
    return parser.parse_args()


def _cases(emulator: Path, pairs: int, options: argparse.Namespace) -> dict[str, dict[str, Any]]:
    trials, results = str(options.trials), {}
    link = (str(emulator), "-n", str(pairs), "-s", str(options.seed))
    with contextlib.ExitStack() as leaders:
        for i in range(pairs):
            serve = ("ip", "netns", "exec", f"nbL{i}", *CAPTURE_APP, "experiment", "link", "--serve")
            leaders.enter_context(running(*serve, "--port", str(PORT)))
        with running(*link):
            time.sleep(1.0)
            results["paper"] = _measure(0, TAP, "--trials", trials)
        with running(*link, "-l", "0.1"):
            time.sleep(1.0)
            results["loss"] = _measure(0, TAP, "--trials", trials)
        results["veth"] = _measure(0, VETH, "--trials", trials)
        with running(*link):
            time.sleep(1.0)
            results["minute"] = _minutes(options.minute_trials, pairs)
    return results


def _client(pair: int, where: str, *arguments: str) -> list[str]:
    connect = ("--connect", f"{where.format(pair)}:{PORT}", "--emulated", "--json")
    return ["ip", "netns", "exec", f"nbC{pair}", *CAPTURE_APP, "experiment", "link", *connect, *arguments]


def _measure(pair: int, where: str, *arguments: str) -> dict[str, Any]:
    print(f"measuring: {' '.join(arguments)} over {where.format(pair)} ...", file=sys.stderr)
    done = subprocess.run(
        _client(pair, where, *arguments),
        cwd=ROOT,
        check=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    return dict(json.loads(done.stdout))


def _minutes(trials: int, pairs: int) -> dict[str, Any]:
    """66 s from 6,000 messages each, the client's clock 20 ppm fast; several pairs at once."""
    print(f"measuring: {trials} times 6,000 messages in 66 s ...", file=sys.stderr)
    arguments = ("--trials", "1", "--messages", "6000", "--pace-ms", "11")
    clock = ("--clock", "sim:offset_s=7200,skew_ppm=20")
    results: list[dict[str, Any]] = []
    while len(results) < trials:
        together = min(pairs, trials - len(results))
        running = [
            subprocess.Popen(
                _client(i, TAP, *arguments, *clock),
                cwd=ROOT,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
            )
            for i in range(together)
        ]
        results += [json.loads(process.communicate()[0]) for process in running]
    return _pooled(results)


def _pooled(results: list[dict[str, Any]]) -> dict[str, Any]:
    """Pool trials of one each."""
    pooled = results[0]
    pooled["trials"] = len(results)
    sections = [("ours", [r["ours"] for r in results])]
    sections += [(name, [r["baseline"][name] for r in results]) for name in pooled["baseline"]]
    for name, parts in sections:
        errors = [part["error_us"]["bias"] for part in parts]
        mean = sum(errors) / len(errors)
        figures = {
            "mean_abs": sum(abs(e) for e in errors) / len(errors),
            "max": max(abs(e) for e in errors),
            "std": (sum((e - mean) ** 2 for e in errors) / len(errors)) ** 0.5,
            "bias": mean,
        }
        (pooled["ours"] if name == "ours" else pooled["baseline"][name])["error_us"] = figures
    for key in ("coverage_95", "coverage_hard_bound", "seconds_mean", "uncertainty_us"):
        pooled["ours"][key] = sum(r["ours"][key] for r in results) / len(results)
    least = pooled["baseline"]["minimum"]["error_us"]["mean_abs"]
    pooled["ours"]["share_of_minimum"] = pooled["ours"]["error_us"]["mean_abs"] / least
    return pooled


def _verdicts(results: dict[str, dict[str, Any]]) -> list[dict[str, Any]]:
    """Each target beside what was measured."""
    paper_us = results["paper"]["ours"]["error_us"]["mean_abs"]
    verdicts = []
    for case, targets in TARGETS.items():
        ours = results[case]["ours"]
        measured = {
            "mean_us": ours["error_us"]["mean_abs"],
            "max_us": ours["error_us"]["max"],
            "share_of_minimum": ours["share_of_minimum"],
            "seconds": ours["seconds_mean"],
            "times_paper": ours["error_us"]["mean_abs"] / paper_us,
        }
        for key, target in targets.items():
            met = measured[key] <= target
            verdicts.append(
                {"case": case, "figure": key, "measured": measured[key], "target": target, "met": met}
            )
        held = ours["coverage_hard_bound"]
        verdicts.append(
            {"case": case, "figure": "hard bound held", "measured": held, "target": 1.0, "met": held == 1.0}
        )
    return verdicts


def _print(report: dict[str, Any]) -> None:
    titles = {
        "paper": "the paper's link, 300 messages",
        "loss": "the same with 10 % loss",
        "veth": "the bare veth, 300 messages",
        "minute": "the paper's link, 6,000 messages in 66 s, clock simulated 20 ppm fast",
    }
    for case, result in report["cases"].items():
        ours = result["ours"]
        print(f"{titles[case]} ({result['kind'] if case != 'veth' else 'real'}, {result['trials']} trials)")
        print(f"  {'error, us':24}{'mean abs':>10}{'largest':>10}{'std':>10}{'bias':>10}{'ours/this':>11}")
        rows = {name: figures["error_us"] for name, figures in result["baseline"].items()}
        for name, errors in {**rows, "ours": ours["error_us"]}.items():
            cells = "".join(f"{errors[key]:10.2f}" for key in ("mean_abs", "max", "std", "bias"))
            print(f"  {name:24}{cells}{ours['error_us']['mean_abs'] / errors['mean_abs']:11.3f}")
        print(
            f"  {ours['seconds_mean']:.2f} s (slowest {ours['seconds_max']:.2f}), 95 % held in "
            f"{100 * ours['coverage_95']:.0f} %, hard bound in {100 * ours['coverage_hard_bound']:.0f} %\n"
        )
    for verdict in report["targets"]:
        says = "met    " if verdict["met"] else "NOT MET"
        against = f"{verdict['measured']:.3f} ({verdict['target']:.3f})"
        print(f"{says} {verdict['case']:7} {verdict['figure']:18} {against}")
    print(f"load average of the machine: {report['load_average']:.1f}")


if __name__ == "__main__":
    sys.exit(main())
