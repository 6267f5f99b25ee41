"""The options and the output that benchmarks share: tables for a reader, or one JSON object."""

import argparse
import json
from collections.abc import Callable
from typing import Any

from capture_app.terminal import print_table

__all__ = ["new_parser", "print_circumstances", "print_report", "print_table"]

Report = dict[str, Any]


def new_parser(description: str | None, *, seed_of: str = "") -> argparse.ArgumentParser:
    """Return a parser with `--json`, and with `--seed` where there is something that it is the seed of."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    if seed_of:
        parser.add_argument("--seed", type=int, default=1, help=f"seed of {seed_of} (1)")
    parser.add_argument("--json", action="store_true", help="print JSON")
    return parser


def print_report(report: Report, print_tables: Callable[[Report], None], *, as_json: bool) -> None:
    """Print a report on stdout."""
    if as_json:
        print(json.dumps(report, indent=2))
    else:
        print_tables(report)


def print_circumstances(report: Report) -> None:
    """Print what the emulated links did, beside what was asked of them, and how busy the machine was."""
    head = (
        "link",
        "to",
        "frames",
        "lost",
        "outliers",
        "mean us",
        "asked",
        "least us",
        "late us",
        "late > 100 us",
    )
    keys = ("drawn_mean_us", "asked_mean_us", "drawn_least_us", "late_mean_us")
    rows = [
        (
            *(str(way[key]) for key in ("link", "to", "frames", "lost", "outliers")),
            *(f"{way[key]:.1f}" for key in keys),
            str(way["late_by_100_us"]),
        )
        for way in report["links"]
    ]
    print()
    print_table(head, rows)
    print(f"load average of the machine: {report['load_average']:.1f}")
