"""Ours where premises fail or nearly do: fast clocks, slewed hosts, warming crystals, bad links.

Each case draws a link, a clock and the messages of many trials, and judges the estimate at many moments.
"""

import random
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

from benchmarks.paper.clock_trials import (
    DrawLink,
    any_law,
    bursty,
    cable,
    rarely_quick,
    steady_times,
)
from benchmarks.paper.result import Table
from benchmarks.simulated.changing_clocks import ChangingClock, RateSpell, draw_wandering_clock
from capture_app.simulation.exchanges import START_TRUE_NS, LocalClock, exchanges_at
from capture_app.sync.clock.clock_filter import ClockFilter

_S = 1_000_000_000
SKEWS_PPM = (0, 30, 100, 150, 300, 1000)
ASYMMETRIES = (0.0, 0.05, 0.1, 0.2)
SLEW_PPM, SUDDEN_PPM, WARMING_PPM_PER_S = 500.0, 100.0, 0.05
CRYSTAL_PPM = 20.0
"""One sigma of the skew where a case says nothing else."""

DrawClock = Callable[[random.Random], LocalClock]
CaseFigures = dict[str, float | str]


def _clock(
    rng: random.Random,
    *,
    skew_ppm: float | None = None,
    slewed_s: tuple[int, int] = (0, 0),
    slew_ppm: float = SLEW_PPM,
    drift: float = 0.0,
) -> ChangingClock:
    """A clock whose skew, slew (between two seconds) and drift (ppm/s) have either sign."""
    sign = rng.choice((-1.0, 1.0))
    skew = rng.gauss(0.0, CRYSTAL_PPM) if skew_ppm is None else sign * skew_ppm
    begin_ns, end_ns = (START_TRUE_NS + second * _S for second in slewed_s)
    slew = RateSpell(begin_ns, end_ns, sign * slew_ppm * 1e-6)
    offset_ns = round(rng.uniform(-36e12, 36e12))
    return ChangingClock(offset_ns, skew * 1e-6, START_TRUE_NS, (slew,), sign * drift)


@dataclass(frozen=True, slots=True)
class Case:
    """What is drawn for each trial, and the seconds after the start at which the estimate is judged."""

    name: str
    clock: DrawClock
    at_s: tuple[float, ...] = (1, 3, 10, 30)
    link: DrawLink = any_law
    holdover_from_s: float | None = None
    """From then on there are no messages."""


FROM_5_TO_60_S, FROM_5_TO_150_S = tuple(range(5, 61)), tuple(range(5, 151))
HOLDOVER_S = (70, 90, 120, 360)
_slewed = partial(_clock, slewed_s=(20, 120))
_sudden = partial(_clock, slewed_s=(20, 10_000), slew_ppm=SUDDEN_PPM)
_warming = partial(_clock, drift=WARMING_PPM_PER_S)
CASES = (
    *(Case(f"skew {ppm} ppm", partial(_clock, skew_ppm=ppm)) for ppm in SKEWS_PPM),
    Case("skew 120 ppm, cable", partial(_clock, skew_ppm=120.0), link=cable),
    Case("slewed leader", _slewed, FROM_5_TO_150_S),
    Case("slewed leader, cable", _slewed, FROM_5_TO_150_S, link=cable),
    Case("sudden 100 ppm", _sudden, FROM_5_TO_60_S),
    Case("warming crystal", _warming, FROM_5_TO_60_S),
    Case("warming crystal, cable", _warming, FROM_5_TO_60_S, link=cable),
    Case("holdover, warming", _warming, HOLDOVER_S, holdover_from_s=60),
    Case("holdover, steady", draw_wandering_clock, HOLDOVER_S, holdover_from_s=60),
    *(
        Case(f"asymmetry {100 * share:.0f} %", draw_wandering_clock, link=partial(any_law, share=share))
        for share in ASYMMETRIES
    ),
    Case("bursty link", draw_wandering_clock, link=bursty),
    Case("rarely quick link", draw_wandering_clock, link=rarely_quick),
)


@dataclass(slots=True)
class CaseResult:
    """What came of a case: errors of all moments in us, what was stated, and the trials whose bound held."""

    name: str
    errors_us: list[float] = field(default_factory=list)
    stated_us: list[float] = field(default_factory=list)
    bounds_us: list[float] = field(default_factory=list)
    trials: int = 0
    bounded_trials: int = 0

    def figures(self) -> CaseFigures:
        """The figures of the case; the shares are from 0 to 1."""
        pairs = zip(self.errors_us, self.stated_us, strict=True)
        count = len(self.errors_us)
        return {
            "name": self.name,
            "trials": self.trials,
            "judged": count,
            "mean_us": sum(self.errors_us) / count,
            "max_us": max(self.errors_us),
            "stated_us": sum(self.stated_us) / count,
            "hard_bound_us": sum(self.bounds_us) / count,
            "hard_bound_held": self.bounded_trials / self.trials,
            "stated_95_held": sum(error <= stated for error, stated in pairs) / count,
        }


def run_case(case: Case, trials: int, seed: str) -> CaseResult:
    """Judge a case in so many trials; the bound of a trial held if it did at all its moments."""
    result = CaseResult(case.name, trials=trials)
    for i in range(trials):
        rng = random.Random(f"{seed} {case.name} {i}")
        result.bounded_trials += _run_trial(case, rng, result)
    return result


def _run_trial(case: Case, rng: random.Random, result: CaseResult) -> bool:
    link, clock = case.link(rng), case.clock(rng)
    last_s = case.at_s[-1] if case.holdover_from_s is None else case.holdover_from_s
    last_ns = round(last_s * _S)
    sent = (START_TRUE_NS + t for t in steady_times(last_ns))
    arriving = iter(exchanges_at(link, clock, rng, sent))
    waiting = next(arriving, None)
    estimator, time_map, bounded = ClockFilter(), None, True
    for at_s in case.at_s:
        true_ns = START_TRUE_NS + round(at_s * _S)
        while waiting is not None and waiting.arrived_true_ns <= true_ns:
            estimator.add(waiting.sample)
            waiting = next(arriving, None)
        local_ns = clock.local_from_true(true_ns)
        if time_map is None or case.holdover_from_s is None:
            until_ns = round((case.holdover_from_s or at_s) * _S)
            time_map = estimator.time_map(clock.local_from_true(START_TRUE_NS + until_ns))
            assert time_map is not None
        error_ns = abs(time_map.leader_from_local(local_ns) - true_ns)
        bound_ns = time_map.hard_bound_at(local_ns)
        bounded = bounded and error_ns <= bound_ns
        result.errors_us.append(error_ns / 1000.0)
        result.stated_us.append(time_map.uncertainty_at(local_ns) / 1000.0)
        result.bounds_us.append(bound_ns / 1000.0)
    return bounded


def case_table(cases: list[CaseFigures]) -> Table:
    """Return the table of all cases."""
    numbers = ("mean_us", "max_us", "stated_us", "hard_bound_us")
    rows = [
        (
            str(case["name"]),
            *(f"{case[name]:.1f}" for name in numbers),
            f"{100 * float(case['stated_95_held']):.1f}",
            f"{100 * float(case['hard_bound_held']):.0f}",
        )
        for case in cases
    ]
    head = (
        "case",
        "mean error",
        "largest",
        "ours states",
        "hard bound",
        "% held",
        "bound held in % of trials",
    )
    return Table(head, rows, "Ours where premises fail, or nearly do; errors in us")
