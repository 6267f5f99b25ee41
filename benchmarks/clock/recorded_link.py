"""Clock synchronization over a recorded link, whose delays are replayed to simulated clocks.

    python -m benchmarks.clock.recorded_link delays.csv [--messages 300] [--trials 100] [--json]

The recording is a CSV with the columns t_s and rtt_ms, a message a row. The clocks are simulated, so the
errors are true.
"""

import csv
import random
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path

from benchmarks.report import new_parser, print_report, print_rows
from capture_app.common.clock import NodeClock, SimulatedClock
from capture_app.common.errors import BadInputError
from capture_app.companions.link.link_measurement import LinkTrial, Synchronization, judge, sum_up
from capture_app.sync.clock.clock_filter import ClockFilter, ClockSample

COLUMNS = ("t_s", "rtt_ms")
MIN_ROWS = 50
MAX_NUMBER = 1e10
"""Upper bound of a recording's times in s, and of its round trips in ms."""
TURNAROUND_NS = 30_000
"""Time that a leader takes from the receipt of a request to the reply."""
START_TRUE_NS = 10**12


@dataclass(frozen=True, slots=True)
class RecordedLink:
    """One-way delays of a recorded link in ns, one of each direction for each `every_ns` of true time."""

    there_ns: tuple[int, ...]
    back_ns: tuple[int, ...]
    every_ns: int

    def exchanges(self, clock: NodeClock, start: int, count: int) -> list[tuple[int, ClockSample]]:
        """Return the samples of `count` messages of a client with this clock, in order of arrival.

        Each comes with the true time in ns at which its reply arrives. The recording is replayed from row
        `start` on, in a loop; the leader's clock is the true time.
        """
        trials = []
        for sent_ns in range(START_TRUE_NS, START_TRUE_NS + count * self.every_ns, self.every_ns):
            t1_ns = sent_ns + self._delay_ns(self.there_ns, start, sent_ns)
            t2_ns = t1_ns + TURNAROUND_NS
            t3_ns = t2_ns + self._delay_ns(self.back_ns, start, t2_ns)
            local_ns = clock.local_from_true(sent_ns), clock.local_from_true(t3_ns)
            trials.append((t3_ns, ClockSample(local_ns[0], t1_ns, t2_ns, local_ns[1])))
        return sorted(trials, key=itemgetter(0))

    def _delay_ns(self, delays_ns: tuple[int, ...], start: int, true_ns: int) -> int:
        return delays_ns[(start + true_ns // self.every_ns) % len(delays_ns)]


def read_trace(path: Path, rng: random.Random) -> RecordedLink:
    """Read a CSV with the columns t_s and rtt_ms as a link with one message a row, at its mean interval.

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
    there_ms = [min_ms / 2.0 + rng.random() * (round_trip_ms - min_ms) for round_trip_ms in round_trips_ms]
    there_ns = tuple(round(way_ms * 1e6) for way_ms in there_ms)
    back_ns = tuple(round((both - way) * 1e6) for both, way in zip(round_trips_ms, there_ms, strict=True))
    return RecordedLink(there_ns, back_ns, every_ns)


def replay(recording: Path, messages: int, *, trials: int, seed: int) -> list[LinkTrial]:
    """Synchronize simulated clocks over a recorded link, each from a random start in the recording.

    The recording is a CSV in the format of `read_trace`; messages follow at its interval. Raises
    BadInputError.
    """
    link = read_trace(recording, random.Random(f"{seed} trace"))
    done = []
    for number in range(trials):
        rng = random.Random(f"{seed} recorded {number}")
        start = rng.randrange(len(link.there_ns))
        # A clock that is hours off, with a skew of 20 ppm (1 sd).
        clock = SimulatedClock(round(rng.uniform(-36e12, 36e12)), rng.gauss(0.0, 20.0), 10**12)
        arrivals_true_ns, samples = zip(*link.exchanges(clock, start, messages), strict=True)
        engine = ClockFilter()
        for sample in samples:
            engine.add(sample)
        time_map = engine.time_map(samples[-1].t3_ns)
        assert time_map is not None
        seconds = (arrivals_true_ns[-1] - START_TRUE_NS) / 1e9
        done.append(judge(Synchronization(list(samples), time_map, seconds, messages), clock))
    return done


def main() -> int:
    """Replay the recording, and print the statistics."""
    parser = new_parser(__doc__, seed_of="the clocks")
    parser.add_argument("recording", type=Path, help="CSV with columns t_s, rtt_ms")
    parser.add_argument("--messages", type=int, default=300, help="messages a trial (300)")
    parser.add_argument("--trials", type=int, default=100, help="trials (100)")
    options = parser.parse_args()
    trials = replay(options.recording, options.messages, trials=options.trials, seed=options.seed)
    figures = sum_up(trials, kind="simulated", messages=options.messages, seed=options.seed)
    columns = {
        "mean_abs_us": ("mean, us", ".2f"),
        "max_us": ("largest, us", ".2f"),
        "coverage_95": ("inside 95 %", ".0%"),
    }
    print_report(figures, lambda report: print_rows([report], columns), as_json=options.json)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
