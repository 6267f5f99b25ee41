"""Make the table of docs/hardware.md from the reports in docs/hardware_reports.

`python docs/hardware_reports.py`. A report is the file of `capture-app doctor --report FILE --camera SPEC`,
as users attach it to an issue, under a name of its own.
"""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from statistics import stdev
from typing import Any

FOLDER = Path(__file__).with_suffix("")
PAGE = FOLDER.with_name("hardware.md")
TABLE = re.compile(r"(?<=<!-- reports -->\n).*?(?=<!-- end of reports -->)", re.S)
COLUMNS = ("camera", "system", "mode", "timestamp jitter", "start scatter", "phase step")


def table() -> str:
    """Return the table, a row for each camera of each report."""
    rows = [row for path in sorted(FOLDER.glob("*.json")) for row in _rows(path)]
    return "".join(f"|{'|'.join(row)}|\n" for row in (COLUMNS, ["---"] * len(COLUMNS), *rows))


def _rows(path: Path) -> Iterator[list[str]]:
    report = json.loads(path.read_text(encoding="utf-8"))
    system = next(finding["text"] for finding in report["doctor"] if finding["check"] == "version")
    for spec, measured in report["cameras"].items():
        said = measured.get("error")
        cells = ["not measured", said, "", ""] if said else _measurements(measured)
        model = spec if said else measured["camera"]["model"]
        yield [f"[{model}](hardware_reports/{path.name})", _system(system), *cells]


def _system(version: str) -> str:
    program, *_, system = version.split(", ")
    return f"{system}, {program.removeprefix('simulshot ')}"


def _measurements(measured: dict[str, Any]) -> list[str]:
    starts = measured["starts"]["latencies_ns"] if measured["starts"] else []
    moves = measured["moves"]
    return [
        measured["modes"].partition(",")[0],
        _duration(measured["stamp_jitter_ns"]),
        _duration(stdev(starts)) if len(starts) > 1 else "–",
        _duration(moves["step_ns"]) if moves and moves["step_ns"] else "–",
    ]


def _duration(ns: float) -> str:
    return f"{ns / 1e3:.0f} µs" if ns < 1e6 else f"{ns / 1e6:.1f} ms"


if __name__ == "__main__":
    page = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(TABLE.sub(lambda _: table(), page), encoding="utf-8")
