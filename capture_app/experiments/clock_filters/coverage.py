"""How often our stated 95 % holds: at once, seconds ahead, after a while, between the polls of a follower.

Each trial has a link of its own whose least delays differ by chance, and a clock that wanders.
"""

import random
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from capture_app.experiments.clock_filters.links import DrawLink
from capture_app.simulation.clocks import draw_wandering_clock
from capture_app.simulation.exchanges import START_TRUE_NS, exchanges_at
from capture_app.sync.clock.clock_filter import ClockFilter
from capture_app.sync.timekeeping import poll_schedule
from capture_app.sync.tree.follower import WINDOW_NS

_S = 1_000_000_000
MOST_TRIALS = 100
"""Of each law in the situations after the first second; they take long."""
FIRST_SECOND, AHEAD_1, AHEAD_5 = "first second", "1 s later", "5 s later"
AHEAD = {FIRST_SECOND: 0, AHEAD_1: _S, AHEAD_5: 5 * _S}
"""How long after the last message of the first second; ns."""
STEADY = {f"asking for {s} s": s * _S for s in (2, 3, 4, 10, 30)}
ROUND, GAP = "after a round", "before the next"
ROUND_EVERY_NS = 50 * _S
ROUNDS_FROM_NS = 300 * _S
SITUATIONS = (*AHEAD, *STEADY, ROUND, GAP)


@dataclass(slots=True)
class Coverage:
    """Stated uncertainties in one situation, the errors, and how often both bounds held."""

    held: int = 0
    bounded: int = 0
    errors_us: list[float] = field(default_factory=list)
    stated_us: list[float] = field(default_factory=list)

    @property
    def share(self) -> float:
        """Share of the trials in which the stated 95 % held."""
        return self.held / len(self.errors_us)


Coverages = Mapping[str, Coverage]
"""By situation."""


def measure_coverage(draw: DrawLink, count: int, seed: str, *, most: int = MOST_TRIALS) -> Coverages:
    """Judge each situation on links that are drawn: the first second in `count` trials, others in `most`."""
    found = {situation: Coverage() for situation in SITUATIONS}
    for i in range(count):
        _first_second(found, _Trial(draw, f"{seed} drawn {i}"))
    for i in range(min(count, most)):
        _steady(found, _Trial(draw, f"{seed} steady {i}"))
        _rounds(found, _Trial(draw, f"{seed} rounds {i}"))
    return found


def steady_times(until_ns: int) -> list[int]:
    """When a client with a camera asks, in ns from the start: quickly at first, then less and less often."""
    paces_ns = [poll_schedule.FIRST_PACE_NS] * poll_schedule.FIRST_SAMPLES
    for pace_ns in poll_schedule.EASING_PACES_NS:
        paces_ns += [pace_ns] * poll_schedule.EASING_SAMPLES
    sent_ns = [0]
    while sent_ns[-1] < until_ns:
        pace_ns = paces_ns[len(sent_ns)] if len(sent_ns) < len(paces_ns) else poll_schedule.PACE_NS
        sent_ns.append(sent_ns[-1] + pace_ns)
    return sent_ns


class _Trial:
    """One link and one clock, drawn by chance."""

    def __init__(self, draw: DrawLink, seed: str) -> None:
        self._rng = random.Random(seed)
        self._link = draw(self._rng)
        self._clock = draw_wandering_clock(self._rng)

    def feed(self, clock: ClockFilter, sent_ns: list[int], until_ns: list[int]) -> Iterator[int]:
        """Add samples to a filter as they arrive, pausing at each of these times; in ns from the start."""
        arrived = iter(exchanges_at(self._link, self._clock, self._rng, (START_TRUE_NS + t for t in sent_ns)))
        waiting = next(arrived, None)
        for stop_ns in until_ns:
            while waiting is not None and waiting.arrived_true_ns <= START_TRUE_NS + stop_ns:
                clock.add(waiting.sample)
                waiting = next(arrived, None)
            yield stop_ns

    def local_ns(self, since_start_ns: int) -> int:
        """The client's clock so long after the start, in ns."""
        return self._clock.local_from_true(START_TRUE_NS + since_start_ns)

    def judge(self, clock: ClockFilter, now_ns: int, ahead: Mapping[str, int], found: Coverages) -> None:
        """Compare the filter's time map at now, and at times ahead of it, with the truth."""
        time_map = clock.time_map(self.local_ns(now_ns))
        assert time_map is not None
        for situation, ahead_ns in ahead.items():
            true_ns = START_TRUE_NS + now_ns + ahead_ns
            local_ns = self.local_ns(now_ns + ahead_ns)
            error_ns = time_map.leader_from_local(local_ns) - true_ns
            stated_ns = time_map.uncertainty_at(local_ns)
            coverage = found[situation]
            coverage.held += abs(error_ns) <= stated_ns
            coverage.bounded += abs(error_ns) <= time_map.hard_bound_at(local_ns)
            coverage.errors_us.append(error_ns / 1000.0)
            coverage.stated_us.append(stated_ns / 1000.0)


def _first_second(found: Coverages, trial: _Trial) -> None:
    sent_ns = [i * poll_schedule.FIRST_PACE_NS for i in range(poll_schedule.FIRST_SAMPLES)]
    clock = ClockFilter()
    for now_ns in trial.feed(clock, sent_ns, [sent_ns[-1] + 5_000_000]):
        trial.judge(clock, now_ns, AHEAD, found)


def _steady(found: Coverages, trial: _Trial) -> None:
    """A client with a camera: it asks in quick succession, then less and less often."""
    clock, situations = ClockFilter(), iter(STEADY)
    for now_ns in trial.feed(clock, steady_times(max(STEADY.values())), sorted(STEADY.values())):
        trial.judge(clock, now_ns, {next(situations): 0}, found)


def _rounds(found: Coverages, trial: _Trial) -> None:
    """A follower: rounds that are further and further apart."""
    sent_ns = [i * poll_schedule.SPACING_NS for i in range(poll_schedule.FIRST_SAMPLES)]
    ends_ns, every_ns = [], float(_S)
    while sent_ns[-1] < ROUNDS_FROM_NS:
        every_ns = min(every_ns * poll_schedule.GROWTH, ROUND_EVERY_NS)
        begin_ns = sent_ns[-1] + round(every_ns)
        sent_ns += [begin_ns + i * poll_schedule.SPACING_NS for i in range(poll_schedule.ROUND_EXCHANGES)]
        ends_ns.append(sent_ns[-1] + 60_000_000)
    clock = ClockFilter(window_ns=WINDOW_NS)
    for now_ns in trial.feed(clock, sent_ns, ends_ns):
        # It looks at its clock after each round.
        clock.time_map(trial.local_ns(now_ns))
    trial.judge(clock, ends_ns[-1], {ROUND: 0, GAP: ROUND_EVERY_NS}, found)
