"""Clock estimators in virtual time: the paper's section 4 with its filters, ours, and other laws of delay."""

import random
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import exp, log
from pathlib import Path

from capture_app.clock import SimulatedClock
from capture_app.experiments.clock_filters.cases import (
    CASES,
    Case,
    CaseFigures,
    case_table,
    recorded_case,
    run_case,
)
from capture_app.experiments.clock_filters.coverage import (
    FIRST_SECOND,
    MOST_TRIALS,
    SITUATIONS,
    Coverages,
    measure_coverage,
)
from capture_app.experiments.clock_filters.links import unequal_links
from capture_app.experiments.clock_filters.report import draw_study, tables
from capture_app.experiments.clock_filters.trials import (
    FIRST,
    PACE_NS,
    EstimatorErrors,
    Study,
    run_convergence_trial,
    run_law_trials,
)
from capture_app.experiments.common.result import Outcome, Result, error_figures
from capture_app.experiments.common.workers import call_all
from capture_app.simulation.network.exchanges import exchanges, read_trace
from capture_app.simulation.network.paper_link import LINKS_BY_LAW, PAPER_LINK

TRIALS = 100
PAPER = {
    "error_us": {"mean": {"bias": 400.0}, "minimum": {"bias": 19.0}},
    "one_way_us": {
        "to_client": {"minimum": 517.0, "mean": 1133.0},
        "to_leader": {"minimum": 479.0, "mean": 1878.0},
    },
    "least_round_trip_us": {"300": 1870.0, "1000": 1020.0, "10000": 996.0},
}


@dataclass(frozen=True, slots=True)
class StudySize:
    """How much is measured beside the trials of each law."""

    messages: int = 10_000
    """On the paper's link, for its delays and for convergence."""
    convergence: tuple[int, ...] = (10, 30, 100, 300, 1000, 3000, 10_000)
    """Numbers of messages after which the errors are judged."""
    convergence_trials: int = 10
    coverage_trials: int = MOST_TRIALS
    cases: tuple[Case, ...] = CASES
    case_trials: int = 30


FULL_SIZE = StudySize()
WORTH_PROCESSES = 20
"""So many trials are worth the start of other processes."""


class ClockResult(Result, frozen=True, kw_only=True):
    """The figures of the experiment, and those of each case."""

    cases: list[CaseFigures]


def run(
    *,
    trials: int | None,
    seed: int,
    talk: Callable[[str], None],
    trace: Path | None = None,
    size: StudySize = FULL_SIZE,
) -> Outcome:
    """Run it; `trace` is a recorded link to replay as one more law."""
    count = TRIALS if trials is None else trials
    links, cases = dict(LINKS_BY_LAW), list(size.cases)
    if trace is not None:
        links["recorded"] = read_trace(trace, random.Random(f"{seed} trace"))
        cases.append(recorded_case(links["recorded"]))
    few = WORTH_PROCESSES if count < WORTH_PROCESSES else 2
    talk(f"{', '.join(links)}: {count} trials of {FIRST} messages")
    runs = [partial(run_law_trials, link, count, f"{seed} {name}") for name, link in links.items()]
    laws = dict(zip(links, call_all(runs, few=few), strict=True))
    talk("how often the stated uncertainty holds")
    judged = [partial(_coverage, name, count, seed, size.coverage_trials) for name in LINKS_BY_LAW]
    coverages = dict(zip(LINKS_BY_LAW, call_all(judged, few=few), strict=True))
    case_trials = min(count, size.case_trials)
    talk(f"{len(cases)} cases in which premises fail or nearly do, {case_trials} trials each")
    found = call_all([partial(run_case, case, case_trials, str(seed)) for case in cases], few=few)
    times = min(count, size.convergence_trials)
    talk(f"{size.messages} messages, {times} times")
    convergence: dict[int, EstimatorErrors] = {k: EstimatorErrors() for k in size.convergence}
    for i in range(times):
        run_convergence_trial(convergence, size.messages, random.Random(f"{seed} convergence {i}"))
    rng = random.Random(f"{seed} scattergram")
    messages = exchanges(PAPER_LINK, SimulatedClock(0), rng, count=size.messages, pace_ns=PACE_NS)
    errors_us = [(m.there_ns - m.back_ns) / 2000.0 for m in messages]
    study = Study(laws, messages, errors_us, convergence, coverages)
    result = _result(study, [case.figures() for case in found], seed, count)
    notes = (
        f"Stated 95 % held in {100 * result.ours['coverage_95']:.1f} % of all trials of the six laws; in "
        f"{100 * result.ours['coverage_95_drawn']:.1f} % where the least delays differ by chance (5 % of "
        f"half the round trip). The hard bound held in {100 * result.ours['coverage_hard_bound']:.1f} %.",
        f"Error of the minimum filter over ours, six laws: {result.ours['gain_mean']:.2f} on average, "
        f"{result.ours['gain_least']:.2f} at least.",
        "Paper: the mean filter is 400 us off, the minimum filter 19 us at best. The least delays of its "
        "link differ by 38 us, and half of that is an error that no exchange can see.",
    )
    shown = (*tables(study), case_table(result.cases))
    return Outcome(result, shown, notes, lambda folder: [draw_study(study, folder / "clock-filters.png")])


def _coverage(law: str, count: int, seed: int, most: int) -> Coverages:
    return measure_coverage(unequal_links(law), count, f"{seed} {law}", most=most)


def _result(study: Study, cases: list[CaseFigures], seed: int, count: int) -> ClockResult:
    def figures(name: str) -> dict[str, object]:
        return {
            "error_us": {law: error_figures(trials.errors_us[name]) for law, trials in study.laws.items()},
            "error_us_after": {
                str(k): error_figures(trials.errors_us[name]) for k, trials in study.convergence.items()
            },
        }

    laws = study.laws.values()
    found = [one for by_situation in study.coverages.values() for one in by_situation.values()]
    bounded = sum(t.bounded for t in laws) + sum(one.bounded for one in found)
    judged = count * len(laws) + sum(len(one.errors_us) for one in found)
    gains = [study.laws[law].gain for law in LINKS_BY_LAW]
    there = [m.there_ns / 1000.0 for m in study.messages]
    back = [m.back_ns / 1000.0 for m in study.messages]
    ours = figures("ours") | {
        "coverage_95": sum(study.laws[law].covered for law in LINKS_BY_LAW) / (count * len(LINKS_BY_LAW)),
        "coverage_95_drawn": study.coverage(FIRST_SECOND),
        "coverage_95_by_law": {law: trials.covered / count for law, trials in study.laws.items()},
        "coverage_95_by_situation": {
            situation: {law: study.coverages[law][situation].share for law in LINKS_BY_LAW}
            | {"all": study.coverage(situation)}
            for situation in SITUATIONS
        },
        "error_us_by_situation": {
            situation: {law: error_figures(study.coverages[law][situation].errors_us) for law in LINKS_BY_LAW}
            for situation in SITUATIONS
        },
        "coverage_hard_bound": bounded / judged,
        "uncertainty_us": {law: sum(trials.uncertainties_us) / count for law, trials in study.laws.items()},
        "gain_by_law": {law: trials.gain for law, trials in study.laws.items()},
        "gain_mean": sum(gains) / len(gains),
        "gain_geometric_mean": exp(sum(log(gain) for gain in gains) / len(gains)),
        "gain_least": min(gains),
        "one_way_us": {
            "to_client": {"minimum": min(back), "mean": sum(back) / len(back)},
            "to_leader": {"minimum": min(there), "mean": sum(there) / len(there)},
        },
        "least_round_trip_us": {
            str(k): min(a + b for a, b in zip(there[:k], back[:k], strict=True)) for k in (300, 1000, 10_000)
        },
    }
    names = [name for name in next(iter(laws)).errors_us if name != "ours"]
    return ClockResult(
        name="clock-filters",
        kind="simulated",
        seed=seed,
        trials=count,
        ours=ours,
        baseline={name: figures(name) for name in names},
        paper=PAPER,
        cases=cases,
    )
