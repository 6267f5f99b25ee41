"""The summary of a batch: CSV for spreadsheets, JSON for programs, HTML for people.

Holds no times of day and no durations: the same units give the same bytes.
"""

import csv
from collections.abc import Sequence
from io import StringIO
from pathlib import Path

import msgspec

from capture_app.session.files.durable import write_atomic
from capture_app.text import pretty_json
from reconstruction.batch.page import summary_page
from reconstruction.batch.rows import BatchResult, Row

CSV, JSON, HTML = "summary.csv", "summary.json", "summary.html"
NAMES = (CSV, JSON, HTML)


def write_summary(root: Path, result: BatchResult) -> None:
    """Write the three files into the batch's folder."""
    write_atomic(root / JSON, pretty_json({"groups": result.groups, "units": result.units}) + b"\n")
    write_atomic(root / CSV, _csv(result.units).encode())
    write_atomic(root / HTML, summary_page(result).encode())


def _csv(rows: Sequence[Row]) -> str:
    text = StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(Row.__struct_fields__)
    for row in rows:
        writer.writerow("" if value is None else value for value in msgspec.structs.astuple(row))
    return text.getvalue()
