"""Fits the two free numbers of the paper's link to the least round trips that the paper gives (simulated).

`python -m benchmarks.clock.paper_link_fit`: the wait of most messages to 1.87 ms in 300 messages, then what
quick ones take beyond their floor to what 1,000 messages need more than 10,000. Prints what follows, too.
"""

import random
from collections.abc import Callable
from statistics import mean, pstdev
from typing import Any

from benchmarks.report import new_parser, print_report
from benchmarks.simulated.wifi_laws import LINKS
from benchmarks.simulated.wireless import PACE_NS, paper_link
from capture_app.common.clock import SimulatedClock
from capture_app.simulation.exchanges import exchanges
from capture_app.simulation.links import Link

STEPS = 9
PANEL_TRIALS = 239


def quickest(link: Link, messages: int, seed: int) -> tuple[float, float]:
    """The least round trip of so many messages, and the error of its offset, in us."""
    found = exchanges(link, SimulatedClock(0), random.Random(seed), count=messages, pace_ns=PACE_NS)
    best = min(found, key=lambda m: m.there_ns + m.back_ns)
    return (best.there_ns + best.back_ns) / 1000.0, (best.there_ns - best.back_ns) / 2000.0


def least_us(link: Link, messages: int, trials: int, seed: int) -> list[float]:
    """The least round trips of some trials."""
    return [quickest(link, messages, 1000 * seed + i)[0] for i in range(trials)]


def where_met(excess: Callable[[float], float], low: float, high: float) -> float:
    """Where a rising function crosses zero; every step draws the same chance."""
    for _ in range(STEPS):
        middle = (low + high) / 2.0
        low, high = (low, middle) if excess(middle) > 0.0 else (middle, high)
    return (low + high) / 2.0


def main() -> None:
    """Fit, and print."""
    parser = new_parser(__doc__, seed_of="all chance")
    parser.add_argument("--trials", type=int, default=400, help="trials of 300 and of 1,000 messages (400)")
    options = parser.parse_args()
    trials, seed, demanded = options.trials, options.seed, LINKS["paper"].statistics.least_round_trip_us

    def too_slow_at_first(wait_us: float) -> float:
        return mean(least_us(paper_link(round(1000 * wait_us)), 300, trials, seed)) - demanded[300]

    def too_far_apart(quick_us: float) -> float:
        link = paper_link(round(1000 * wait_us), round(1000 * quick_us))
        few, many = (
            mean(least_us(link, count, n, seed)) for count, n in ((1000, trials), (10_000, trials // 10))
        )
        return (few - many) - (demanded[1000] - demanded[10_000])

    wait_us = where_met(too_slow_at_first, 200.0, 600.0)
    quick_us = where_met(too_far_apart, 20.0, 100.0)
    link = LINKS["paper"].link
    shown = {count: least_us(link, count, n, seed + 1) for count, n in ((300, trials), (1000, trials))}
    shown[10_000] = least_us(link, 10_000, trials // 10, seed + 1)
    panel = [abs(quickest(link, 300, i)[1]) for i in range(PANEL_TRIALS)]
    report: dict[str, Any] = {
        "kind": "simulated",
        "trials": trials,
        "seed": seed,
        "fitted_us": {"wait": wait_us, "quick": quick_us},
        "least_round_trip_us": {str(k): mean(values) for k, values in shown.items()},
        "least_round_trip_std_us": {str(k): pstdev(values) for k, values in shown.items()},
        "minimum_filter_us": {
            "trials": PANEL_TRIALS,
            "mean": mean(panel),
            "max": max(panel),
            "std": pstdev(panel),
        },
    }
    print_report(report, _print, as_json=options.json)


def _print(report: dict[str, Any]) -> None:
    for name, value in report.items():
        print(f"{name}: {value}")


if __name__ == "__main__":
    main()
