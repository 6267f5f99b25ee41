"""A recorded link: the round trips of a real network, divided into two ways to be replayed."""

import csv
import random
from pathlib import Path

from capture_app.errors import BadInputError
from capture_app.simulation.link import Link, ReplayedLaw

COLUMNS = ("t_s", "rtt_ms")
LEAST_ROWS = 50


def read_trace(path: Path, rng: random.Random) -> Link:
    """Read a CSV with the columns t_s and rtt_ms as a link that replays it row by row, at its own pace.

    A recording does not tell how a round trip divides: both ways get half the least round trip, and what a
    row has above that is divided by chance. Raises BadInputError.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = [tuple(float(row[name]) for name in COLUMNS) for row in csv.DictReader(file)]
    except (OSError, KeyError, TypeError, ValueError, UnicodeDecodeError) as error:
        raise BadInputError(
            f"cannot read the recorded link {path}: {error}", hint=f"a CSV with columns {', '.join(COLUMNS)}"
        ) from None
    if len(rows) < LEAST_ROWS:
        raise BadInputError(f"{path} has {len(rows)} rows", hint=f"{LEAST_ROWS} or more are needed")
    times_s, round_trips_ms = zip(*rows, strict=True)
    every_ns = round((times_s[-1] - times_s[0]) / (len(rows) - 1) * 1e9)
    least_ms = min(round_trips_ms)
    if every_ns <= 0 or not least_ms > 0:
        raise BadInputError(f"{path} has times that do not ascend, or round trips that are not positive")
    there_ns, back_ns = [], []
    for round_trip_ms in round_trips_ms:
        part_ms = rng.random() * (round_trip_ms - least_ms)
        there_ns.append(round((least_ms / 2.0 + part_ms) * 1e6))
        back_ns.append(round((round_trip_ms - least_ms / 2.0 - part_ms) * 1e6))
    return Link(ReplayedLaw(tuple(there_ns), every_ns), ReplayedLaw(tuple(back_ns), every_ns))
