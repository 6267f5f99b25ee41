"""Shared options and output of benchmarks: tables for a reader, or one JSON object."""

import argparse
import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from capture_app.console.terminal import print_line, table, talk

__all__ = [
    "new_parser",
    "print_circumstances",
    "print_report",
    "print_rows",
    "print_table",
    "print_targets",
    "talk",
]

Report = dict[str, Any]
Columns = Mapping[str, tuple[str, str]]
"""Columns of a table: the key in each row, its heading and its format."""


def new_parser(description: str | None, *, seed_of: str = "") -> argparse.ArgumentParser:
    """Return a parser with `--json`, and with `--seed` if `seed_of` names what it seeds."""
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


def print_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table on stdout."""
    print_line(table(head, rows))


def print_rows(rows: Sequence[Mapping[str, Any]], columns: Columns) -> None:
    """Print a table of figures on stdout; missing values are a dash. Fractions get a heading in %."""

    def cell(value: Any, form: str) -> str:
        return "-" if value is None else format(value, form).removesuffix("%")

    head = [f"{heading}, %" if form.endswith("%") else heading for heading, form in columns.values()]
    print_table(head, [[cell(row.get(key), form) for key, (_, form) in columns.items()] for row in rows])


TARGET_COLUMNS: Columns = {
    "says": ("", ""),
    "figure": ("figure", ""),
    "measured": ("measured", ".1f"),
    "target": ("target", ".1f"),
}


def print_targets(targets: Sequence[Mapping[str, Any]], columns: Columns = TARGET_COLUMNS) -> None:
    """Print on stdout which targets were `met`, with the given columns."""
    print_rows([{**one, "says": "met" if one["met"] else "NOT MET"} for one in targets], columns)


LINK_COLUMNS: Columns = {
    "link": ("link", ""),
    "to": ("to", ""),
    "frames": ("frames", ""),
    "lost": ("lost", ""),
    "outliers": ("outliers", ""),
    "drawn_mean_us": ("mean us", ".1f"),
    "asked_mean_us": ("asked", ".1f"),
    "drawn_least_us": ("least us", ".1f"),
    "late_mean_us": ("late us", ".1f"),
    "late_by_100_us": ("late > 100 us", ""),
}


def print_circumstances(report: Report) -> None:
    """Print the emulated links' statistics beside their settings, and the machine's load."""
    print()
    print_rows(report["links"], LINK_COLUMNS)
    print(f"load average of the machine: {report['load_average']:.1f}")
