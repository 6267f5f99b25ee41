"""Random links and clocks, and the accuracy of estimators on their messages."""

import random
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace

from benchmarks.paper.clock_estimators import ClockEstimator, estimator_family
from benchmarks.paper.result import error_figures
from benchmarks.simulated.changing_clocks import draw_wandering_clock
from benchmarks.simulated.links import START_TRUE_NS, DelayLaw, Link, exchanges, exchanges_at
from benchmarks.simulated.wifi_laws import LINKS_BY_LAW
from benchmarks.simulated.wireless import (
    PAPER_LINK,
    POLL_INTERVAL_NS,
    GammaDelay,
    WirelessLink,
    wireless,
)
from capture_app.common.clock import SimulatedClock
from capture_app.sync.clock.clock_filter import ClockFilter
from capture_app.sync.timekeeping import poll_schedule

FIRST = 300
"""K of the paper, and of our engine."""
LAW_PACE_NS = 3_000_000
SKEW_PPM = 20.0
"""Standard deviation of the clients' skew in each trial; offsets are hours."""


@dataclass(slots=True)
class EstimatorErrors:
    """Errors of each estimator in us over all trials under one law, and coverage of our bounds."""

    errors_us: dict[str, list[float]] = field(default_factory=dict)
    covered: int = 0
    bounded: int = 0
    uncertainties_us: list[float] = field(default_factory=list)

    def add(self, name: str, estimator: ClockEstimator, clock: SimulatedClock, true_ns: int) -> None:
        """Judge an estimator's time map at a true time in ns."""
        local_ns = clock.local_from_true(true_ns)
        time_map = estimator.time_map(local_ns)
        assert time_map is not None
        error_ns = time_map.leader_from_local(local_ns) - true_ns
        self.errors_us.setdefault(name, []).append(error_ns / 1000.0)
        if name == "ours":
            self.covered += abs(error_ns) <= time_map.uncertainty_ns
            self.bounded += abs(error_ns) <= time_map.hard_bound_ns
            self.uncertainties_us.append(time_map.uncertainty_ns / 1000.0)

    def mean_abs(self, name: str) -> float:
        """Return the mean absolute error of an estimator in us."""
        return error_figures(self.errors_us[name])["mean_abs"]


def draw_clock(rng: random.Random) -> SimulatedClock:
    """Draw a client's clock: hours of offset, SKEW_PPM of skew."""
    return SimulatedClock(round(rng.uniform(-36e12, 36e12)), rng.gauss(0.0, SKEW_PPM), 10**12)


def run_law_trials(link: Link, count: int, seed: str) -> EstimatorErrors:
    """Give all estimators the same messages in each trial, and judge them after the last one."""
    result = EstimatorErrors()
    for i in range(count):
        rng = random.Random(f"{seed} {i}")
        clock = draw_clock(rng)
        messages = exchanges(link, clock, rng, count=FIRST, poll_interval_ns=LAW_PACE_NS)
        family = estimator_family()
        for message in messages:
            for estimator in family.values():
                estimator.add(message.sample)
        true_ns = max(message.arrived_true_ns for message in messages)
        for name, estimator in family.items():
            result.add(name, estimator, clock, true_ns)
    return result


HALF_LEAST_NS = 498_000
"""Half the minimum round trip of the paper's link: the bound of the asymmetry."""
ASYMMETRY = 0.05
"""Standard deviation of half the difference of the minimum delays, as a fraction of half the round trip."""

DrawLink = Callable[[random.Random], Link]


def unequal(
    link: Link, rng: random.Random, *, half_ns: int = HALF_LEAST_NS, share: float = ASYMMETRY
) -> WirelessLink:
    """Return a link with half this minimum round trip, and random asymmetry of the minimum delays."""
    same = wireless(link)
    shift_ns = round(rng.gauss(0.0, share * half_ns))
    floors = same if same.quick is None else same.quick
    there_ns = half_ns + shift_ns - _minimum(floors.to_leader)
    back_ns = half_ns - shift_ns - _minimum(floors.to_client)
    quick = same.quick
    if quick is not None:
        to_leader, to_client = _moved(quick.to_leader, there_ns), _moved(quick.to_client, back_ns)
        quick = replace(quick, to_leader=to_leader, to_client=to_client)
    to_leader, to_client = _moved(same.to_leader, there_ns), _moved(same.to_client, back_ns)
    return replace(same, to_leader=to_leader, to_client=to_client, quick=quick)


def unequal_links(law: str) -> DrawLink:
    """Return asymmetric links under one of the laws."""
    return lambda rng: unequal(LINKS_BY_LAW[law], rng)


def _minimum(law: DelayLaw) -> int:
    assert isinstance(law, GammaDelay)
    return law.minimum_ns


def _moved(law: DelayLaw, by_ns: int) -> DelayLaw:
    """Return the same law with minimum and mean shifted."""
    assert isinstance(law, GammaDelay)
    return replace(law, minimum_ns=law.minimum_ns + by_ns, mean_ns=law.mean_ns + by_ns)


_S = 1_000_000_000
MOST_TRIALS = 100
"""Trials of each law in the situations after the first second; they take long."""
FIRST_SECOND, AHEAD_1, AHEAD_5 = "first second", "1 s later", "5 s later"
AHEAD = {FIRST_SECOND: 0, AHEAD_1: _S, AHEAD_5: 5 * _S}
"""Time after the last message of the first second; ns."""
STEADY = {f"asking for {s} s": s * _S for s in (2, 3, 4, 10, 30)}
SITUATIONS = (*AHEAD, *STEADY)


@dataclass(slots=True)
class Coverage:
    """Stated uncertainties in one situation, the errors, and the coverage of both bounds."""

    held: int = 0
    bounded: int = 0
    errors_us: list[float] = field(default_factory=list)
    stated_us: list[float] = field(default_factory=list)

    @property
    def share(self) -> float:
        """Return the fraction of the trials in which the stated 95 % held."""
        return self.held / len(self.errors_us)


Coverages = Mapping[str, Coverage]
"""Coverage by situation."""


def measure_coverage(draw: DrawLink, count: int, seed: str, *, most: int = MOST_TRIALS) -> Coverages:
    """Judge each situation on random links: the first second in `count` trials, others in `most`."""
    found = {situation: Coverage() for situation in SITUATIONS}
    for i in range(count):
        _first_second(found, _Trial(draw, f"{seed} drawn {i}"))
    for i in range(min(count, most)):
        _steady(found, _Trial(draw, f"{seed} steady {i}"))
    return found


def steady_times(until_ns: int) -> list[int]:
    """Return the request times of a camera's client, in ns from the start; first quickly, then less often."""
    paces_ns = [poll_schedule.FIRST_INTERVAL_NS] * poll_schedule.FIRST_SAMPLES
    for poll_interval_ns in poll_schedule.EASING_INTERVALS_NS:
        paces_ns += [poll_interval_ns] * poll_schedule.EASING_SAMPLES
    sent_ns = [0]
    while sent_ns[-1] < until_ns:
        poll_interval_ns = (
            paces_ns[len(sent_ns)] if len(sent_ns) < len(paces_ns) else poll_schedule.POLL_INTERVAL_NS
        )
        sent_ns.append(sent_ns[-1] + poll_interval_ns)
    return sent_ns


class _Trial:
    """One random link and one random clock."""

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
        """Return the client's clock at this time after the start, in ns."""
        return self._clock.local_from_true(START_TRUE_NS + since_start_ns)

    def judge(self, clock: ClockFilter, now_ns: int, ahead: Mapping[str, int], found: Coverages) -> None:
        """Compare the filter's time map with the truth, at now and at times ahead of it."""
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
    sent_ns = [i * poll_schedule.FIRST_INTERVAL_NS for i in range(poll_schedule.FIRST_SAMPLES)]
    clock = ClockFilter()
    for now_ns in trial.feed(clock, sent_ns, [sent_ns[-1] + 5_000_000]):
        trial.judge(clock, now_ns, AHEAD, found)


def _steady(found: Coverages, trial: _Trial) -> None:
    """Simulate a camera's client: it asks in quick succession, then less and less often."""
    clock, situations = ClockFilter(), iter(STEADY)
    for now_ns in trial.feed(clock, steady_times(max(STEADY.values())), sorted(STEADY.values())):
        trial.judge(clock, now_ns, {next(situations): 0}, found)


COUNTS = (10, 30, 100, 300, 1000, 3000, 10_000)
WHOLE_RUN_NS = 1000 * _S
"""Window that forgets nothing."""
ENGINE_WINDOW_NS = 30 * _S
"""Window of all filters where clocks drift apart: the same as the engine's."""


@dataclass(slots=True)
class Convergence:
    """Errors of each filter after K messages, K ascending."""

    after: dict[int, EstimatorErrors] = field(default_factory=dict)

    def mean_abs(self, name: str) -> list[float]:
        """Return the mean absolute errors of a filter in us, by K."""
        return [errors.mean_abs(name) for errors in self.after.values()]


@dataclass(frozen=True, slots=True)
class Setting:
    """Rate of the messages, and what is known of the clocks."""

    name: str
    skewed: bool
    window_ns: int


AS_THE_PAPER = Setting("no skew, a message each 3.43 ms", skewed=False, window_ns=WHOLE_RUN_NS)
BY_DEFAULT = Setting("skews of 20 ppm, the engine's own pace", skewed=True, window_ns=ENGINE_WINDOW_NS)


def converge(setting: Setting, counts: tuple[int, ...], trials: int, seed: str) -> Convergence:
    """Give all filters the same messages on the paper's link, and judge them after each of `counts`."""
    found = Convergence({count: EstimatorErrors() for count in sorted(counts)})
    for i in range(trials):
        rng = random.Random(f"{seed} {i}")
        clock = draw_clock(rng) if setting.skewed else SimulatedClock(round(rng.uniform(-36e12, 36e12)))
        family = estimator_family(setting.window_ns)
        arrived = exchanges_at(PAPER_LINK, clock, rng, _times_ns(setting, max(counts)))
        for k, message in enumerate(arrived, start=1):
            for name, estimator in family.items():
                estimator.add(message.sample)
                if k in found.after:
                    found.after[k].add(name, estimator, clock, message.arrived_true_ns)
    return found


def _times_ns(setting: Setting, count: int) -> list[int]:
    if not setting.skewed:
        return [START_TRUE_NS + i * POLL_INTERVAL_NS for i in range(count)]
    until_ns = _S
    while len(sent_ns := steady_times(until_ns)) < count:
        until_ns *= 2
    return [START_TRUE_NS + t for t in sent_ns[:count]]
