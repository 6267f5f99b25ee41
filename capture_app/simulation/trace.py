"""A recorded link: round trips and clock offsets of a real network, split into delays to be replayed."""

import csv
from pathlib import Path
from statistics import median

from capture_app.errors import BadInputError
from capture_app.simulation.link import Link, ReplayedLaw

COLUMNS = ("t_s", "rtt_ms", "clock_offset_ms")
SMOOTH_ROWS = 25
"""The slow part of the recorded offset, a running median of twice as many rows, is the clocks' own."""


def read_trace(path: Path) -> Link:
    """Read a CSV with the columns t_s, rtt_ms and clock_offset_ms as a link that replays it row by row.

    One way takes half the round trip plus what the offset departs from its running median, the other half
    the round trip less it, each at least a tenth of the round trip. Raises BadInputError.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = [tuple(float(row[name]) for name in COLUMNS) for row in csv.DictReader(file)]
    except (OSError, KeyError, TypeError, ValueError, UnicodeDecodeError) as error:
        raise BadInputError(
            f"cannot read the recorded link {path}: {error}", hint=f"a CSV with columns {', '.join(COLUMNS)}"
        ) from None
    if len(rows) < 2 * SMOOTH_ROWS:
        raise BadInputError(f"{path} has {len(rows)} rows", hint=f"{2 * SMOOTH_ROWS} or more are needed")
    times_s, round_trips_ms, offsets_ms = zip(*rows, strict=True)
    every_ns = round((times_s[-1] - times_s[0]) / (len(rows) - 1) * 1e9)
    if every_ns <= 0 or min(round_trips_ms) <= 0:
        raise BadInputError(f"{path} has times that do not ascend, or round trips that are not positive")
    there_ns, back_ns = [], []
    for i, round_trip_ms in enumerate(round_trips_ms):
        near = offsets_ms[max(0, i - SMOOTH_ROWS) : i + SMOOTH_ROWS + 1]
        half_ms, most_ms = round_trip_ms / 2.0, 0.4 * round_trip_ms
        departure_ms = min(max(offsets_ms[i] - median(near), -most_ms), most_ms)
        there_ns.append(round((half_ms + departure_ms) * 1e6))
        back_ns.append(round((half_ms - departure_ms) * 1e6))
    return Link(ReplayedLaw(tuple(there_ns), every_ns), ReplayedLaw(tuple(back_ns), every_ns))
