"""IP cameras' times over ten minutes, in virtual time: error and bar, with sender reports and without.

    python -m benchmarks.clock.ip_camera_clock

The camera's clock is off and drifts; packets pass a WiFi of the paper's delays in their order, as TCP has it.
The error of times by reports is against the frames' timestamps; that of times by arrival against what such a
time tells: the frame, and the least that it takes to be encoded and carried. Simulated.
"""

import random
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from heapq import merge
from statistics import median
from typing import Any

from benchmarks.report import new_parser, print_report, print_rows
from benchmarks.simulated.wireless import WIFI, GammaDelay
from capture_app.cameras.rtsp.sender_clock import SenderClock

S, MS = 1_000_000_000, 1_000_000
FPS, TICKS_PER_S, ASK_NS = 25, 90_000, 2 * S
ENCODING_NS = 40 * MS, 15 * MS
"""The least, and the mean of what comes on top of it."""
COLUMNS = {
    "clock": ("clock off by", ""),
    "reports": ("reports", ""),
    "since": ("after", ""),
    "frames": ("frames", "d"),
    "median_ms": ("median error, ms", ".2f"),
    "largest_ms": ("largest", ".2f"),
    "bar_ms": ("bar (95 %)", ".2f"),
    "within": ("within the bar", ".1%"),
}
SPANS = (("0 to 30 s", 0, 30 * S), ("30 s to 2 min", 30 * S, 120 * S), ("2 to 10 min", 120 * S, 600 * S))


@dataclass(frozen=True, slots=True)
class Case:
    """A camera: how far its wall clock is off, how fast its clocks run, how often it reports."""

    off_s: int
    ppm: float
    report_every_s: float | None


CASES = [
    Case(off_s, ppm, every_s) for off_s, ppm in ((3, 40.0), (3600, -40.0)) for every_s in (1.0, 5.0, None)
]
Event = tuple[int, str, int, int]
"""When it arrives, what it is, when the camera sent or stamped it, by true time in ns, and its timestamp."""


def events(case: Case, rng: random.Random, until_ns: int) -> Iterator[Event]:
    """What arrives, in order."""

    def ticks_at(true_ns: int) -> int:
        # Its wall clock counts from the timestamp of the first second, as most cameras' does.
        shown_ns = true_ns * (1 + case.ppm * 1e-6) + case.off_s * S
        return round(shown_ns * TICKS_PER_S / S) % 2**32

    def frames() -> Iterator[tuple[int, str, int]]:
        for number in range(until_ns * FPS // S):
            true_ns = number * S // FPS
            least_ns, mean_ns = ENCODING_NS
            yield true_ns + least_ns + round(rng.expovariate(1 / mean_ns)), "frame", true_ns

    def reports() -> Iterator[tuple[int, str, int]]:
        true_ns = S // 2
        while case.report_every_s is not None and true_ns < until_ns:
            yield true_ns, "report", true_ns
            # RFC 3550, section 6.2: at random, so that reports of many do not meet.
            true_ns += round(case.report_every_s * S * rng.uniform(0.5, 1.5))

    arrived_ns = 0
    for sent_ns, kind, true_ns in merge(sorted(frames()), reports()):
        arrived_ns = max(arrived_ns, sent_ns + WIFI.to_client.draw(rng))
        yield arrived_ns, kind, true_ns, ticks_at(true_ns)


def run(case: Case, seed: int) -> list[dict[str, Any]]:
    """The rows of one camera."""
    rng = random.Random(seed)
    questions = (WIFI.to_leader.draw(rng) + WIFI.to_client.draw(rng) for _ in range(25))
    round_trips_ns = deque(questions, maxlen=100)
    clock, asked_ns, begun = SenderClock(TICKS_PER_S, round_trips_ns), 0, False
    assert isinstance(WIFI.to_client, GammaDelay)
    least_ns = 0 if case.report_every_s else ENCODING_NS[0] + WIFI.to_client.minimum_ns
    told: list[tuple[int, int, int]] = []
    for arrived_ns, kind, true_ns, ticks in events(case, rng, 600 * S):
        if arrived_ns - asked_ns > ASK_NS:
            asked_ns = arrived_ns
            round_trips_ns.append(WIFI.to_leader.draw(rng) + WIFI.to_client.draw(rng))
        if kind == "report":
            clock.add_report(ticks, arrived_ns)
            continue
        media_ns = clock.add_frame(ticks, arrived_ns)
        if not begun and (clock.reports >= 2 or arrived_ns > 8 * S):
            begun = True
            assert clock.follow_reports() == (case.report_every_s is not None)
        if begun:
            error_ns = clock.host_ns(media_ns) - true_ns - least_ns
            told.append((true_ns, error_ns, clock.uncertainty_ns(media_ns)))
    rows = []
    for since, first_ns, last_ns in SPANS:
        those = [(abs(error), bar) for at, error, bar in told if first_ns <= at < last_ns]
        row = {
            "clock": f"{case.off_s} s, {case.ppm:+.0f} ppm",
            "reports": f"each {case.report_every_s:g} s" if case.report_every_s else "none",
            "since": since,
            "frames": len(those),
            "median_ms": median(error for error, _ in those) / MS,
            "largest_ms": max(error for error, _ in those) / MS,
            "bar_ms": median(bar for _, bar in those) / MS,
            "within": sum(error <= bar for error, bar in those) / len(those),
        }
        rows.append(row)
    return rows


def main() -> None:
    """Run all cameras and print them."""
    parser = new_parser(__doc__, seed_of="delays")
    options = parser.parse_args()
    report = {"cameras": [row for case in CASES for row in run(case, options.seed)]}
    print_report(report, lambda found: print_rows(found["cameras"], COLUMNS), as_json=options.json)


if __name__ == "__main__":
    main()
