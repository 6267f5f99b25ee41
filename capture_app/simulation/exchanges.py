"""Samples of time messages over a simulated link, and links that replay a recording."""

import csv
import random
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from capture_app.common.errors import BadInputError
from capture_app.simulation.links import Link, ReplayedDelay
from capture_app.sync.clock.clock_filter import ClockSample

COLUMNS = ("t_s", "rtt_ms")
MIN_ROWS = 50
MAX_NUMBER = 1e10
"""Upper bound of a recording's times in s, and of its round trips in ms."""
TURNAROUND_NS = 30_000
"""Time that a leader takes from the receipt of a request to the reply."""
START_TRUE_NS = 10**12


def read_trace(path: Path, rng: random.Random) -> Link:
    """Read a CSV with the columns t_s and rtt_ms as a link that replays it row by row, at its mean interval.

    A recording does not show how a round trip divides. Both directions get half of the minimum round trip;
    each row's excess over it is divided at random. Raises BadInputError.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = [tuple(float(row[name]) for name in COLUMNS) for row in csv.DictReader(file)]
    except (OSError, KeyError, TypeError, ValueError, UnicodeDecodeError) as error:
        raise BadInputError(
            f"cannot read the recorded link {path}: {error}", hint=f"a CSV with columns {', '.join(COLUMNS)}"
        ) from None
    if len(rows) < MIN_ROWS:
        raise BadInputError(f"{path} has {len(rows)} rows", hint=f"{MIN_ROWS} or more are needed")
    if not all(abs(number) < MAX_NUMBER for row in rows for number in row):
        raise BadInputError(
            f"{path} has numbers that are not finite, or too large for times", hint="leave lost messages out"
        )
    times_s, round_trips_ms = zip(*rows, strict=True)
    every_ns = round((times_s[-1] - times_s[0]) / (len(rows) - 1) * 1e9)
    min_ms = min(round_trips_ms)
    if every_ns <= 0 or not min_ms > 0:
        raise BadInputError(
            f"{path} has times that do not ascend, or round trips that are not positive",
            hint="sort the rows by t_s, and leave lost messages out",
        )
    there_ns, back_ns = [], []
    for round_trip_ms in round_trips_ms:
        part_ms = rng.random() * (round_trip_ms - min_ms)
        there_ns.append(round((min_ms / 2.0 + part_ms) * 1e6))
        back_ns.append(round((round_trip_ms - min_ms / 2.0 - part_ms) * 1e6))
    return Link(ReplayedDelay(tuple(there_ns), every_ns), ReplayedDelay(tuple(back_ns), every_ns))


class LocalClock(Protocol):
    """A client's clock, with or without drift."""

    def local_from_true(self, true_ns: int) -> int:
        """Return this clock's reading in ns at a true time in ns."""


@dataclass(frozen=True, slots=True)
class Exchange:
    """A sample and the true time in ns at which its reply arrived; the leader's clock is the true time."""

    sample: ClockSample
    arrived_true_ns: int
    there_ns: int
    back_ns: int


def exchanges(
    link: Link, clock: LocalClock, rng: random.Random, *, count: int, poll_interval_ns: int
) -> list[Exchange]:
    """Send a request every `poll_interval_ns`; return the completed exchanges in order of arrival.

    The first copy of a duplicated datagram counts, as in the engine.
    """
    return exchanges_at(
        link, clock, rng, range(START_TRUE_NS, START_TRUE_NS + count * poll_interval_ns, poll_interval_ns)
    )


def exchanges_at(
    link: Link, clock: LocalClock, rng: random.Random, sent_true_ns: Iterable[int]
) -> list[Exchange]:
    """Send a request at each of these true times in ns; return completed exchanges as `exchanges` does."""
    channel, found = link.open(), []
    for sent_ns in sent_true_ns:
        there = channel.deliveries("to_leader", sent_ns, rng)
        if not there:
            continue
        t1_ns = sent_ns + min(there)
        t2_ns = t1_ns + TURNAROUND_NS
        back = channel.deliveries("to_client", t2_ns, rng)
        if back:
            t3_ns = t2_ns + min(back)
            local_ns = clock.local_from_true(sent_ns), clock.local_from_true(t3_ns)
            sample = ClockSample(local_ns[0], t1_ns, t2_ns, local_ns[1])
            found.append(Exchange(sample, t3_ns, min(there), min(back)))
    return sorted(found, key=lambda e: e.arrived_true_ns)
