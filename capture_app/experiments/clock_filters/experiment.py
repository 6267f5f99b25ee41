"""Clock estimators in virtual time: the paper's section 4 with its filters, ours, and other laws of delay."""

import random
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import exp, log
from pathlib import Path

from capture_app.experiments.clock_filters.cases import (
    CASES,
    Case,
    CaseFigures,
    case_table,
    recorded_case,
    run_case,
)
from capture_app.experiments.clock_filters.convergence import (
    AS_THE_PAPER,
    BY_DEFAULT,
    COUNTS,
    converge,
)
from capture_app.experiments.clock_filters.coverage import (
    FIRST_SECOND,
    MOST_TRIALS,
    SITUATIONS,
    Coverages,
    measure_coverage,
)
from capture_app.experiments.clock_filters.links import unequal_links
from capture_app.experiments.clock_filters.paper_protocol import (
    MESSAGES,
    least_round_trips,
    one_way_table,
    run_of_messages,
)
from capture_app.experiments.clock_filters.report import Study, draw_study, tables
from capture_app.experiments.clock_filters.trials import FIRST, run_law_trials
from capture_app.experiments.common.paper_values import FIGURE_S2, LEAST_ROUND_TRIP, TABLE_3
from capture_app.experiments.common.result import Outcome, Result, error_figures
from capture_app.experiments.common.workers import call_all
from capture_app.simulation.exchanges import read_trace
from capture_app.simulation.paper_link import LINKS_BY_LAW

TRIALS = 100
PAPER = {
    "error_us": {name: {"bias": FIGURE_S2[f"{name}.10000"]} for name in ("mean", "minimum")},
    "one_way_us": {
        way: {part: TABLE_3[f"{way}.{part}"] for part in ("least", "mean")}
        for way in ("to_client", "to_leader")
    },
    "least_round_trip_us": {name: LEAST_ROUND_TRIP[name] for name in LEAST_ROUND_TRIP.names},
}
LEAST_TRIALS = 30
"""Runs of each length of which the least round trips are averaged; a tenth of them of the longest."""


@dataclass(frozen=True, slots=True)
class StudySize:
    """How much is measured beside the trials of each law."""

    messages: int = MESSAGES
    """Of the run as the paper's."""
    convergence: tuple[int, ...] = COUNTS
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
    settings = (AS_THE_PAPER, BY_DEFAULT)
    converging = [
        partial(converge, setting, size.convergence, times, f"{seed} convergence") for setting in settings
    ]
    convergence = dict(zip(settings, call_all(converging, few=few), strict=True))
    messages = run_of_messages(f"{seed} run", size.messages)
    times = min(count, LEAST_TRIALS)
    least = least_round_trips(str(seed), {300: times, 1000: times, size.messages: max(1, times // 10)})
    study = Study(laws, messages, convergence, coverages)
    result = _result(study, least, [case.figures() for case in found], seed, count)
    notes = (
        f"Stated 95 % held in {100 * result.ours['coverage_95']:.1f} % of all trials of all laws; in "
        f"{100 * result.ours['coverage_95_drawn']:.1f} % where the least delays differ by chance (5 % of "
        f"half the round trip). The hard bound held in {100 * result.ours['coverage_hard_bound']:.1f} %.",
        f"Error of the minimum filter over ours, all laws: {result.ours['gain_mean']:.2f} on average, "
        f"{result.ours['gain_least']:.2f} at least.",
        f"Paper: after 10,000 messages the mean filter is {FIGURE_S2['mean.10000']:.0f} us off, the minimum "
        f"filter {FIGURE_S2['minimum.10000']:.0f}: so the one quickest message divided. How unequal the two "
        "ways of a link are no exchange can show; half the least round trip bounds it.",
    )
    shown = (*tables(study), case_table(result.cases))
    return Outcome(result, shown, notes, lambda folder: draw_study(study, folder))


def _coverage(law: str, count: int, seed: int, most: int) -> Coverages:
    return measure_coverage(unequal_links(law), count, f"{seed} {law}", most=most)


def _result(
    study: Study, least: dict[int, list[float]], cases: list[CaseFigures], seed: int, count: int
) -> ClockResult:
    def figures(name: str) -> dict[str, object]:
        return {
            "error_us": {law: error_figures(trials.errors_us[name]) for law, trials in study.laws.items()},
            **{
                key: {
                    str(k): error_figures(trials.errors_us[name])
                    for k, trials in study.convergence[setting].after.items()
                }
                for key, setting in (("error_us_after", AS_THE_PAPER), ("error_us_after_skewed", BY_DEFAULT))
            },
        }

    laws = study.laws.values()
    found = [one for by_situation in study.coverages.values() for one in by_situation.values()]
    bounded = sum(t.bounded for t in laws) + sum(one.bounded for one in found)
    judged = count * len(laws) + sum(len(one.errors_us) for one in found)
    gains = [study.laws[law].gain for law in LINKS_BY_LAW]
    table = one_way_table(study.messages)
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
            way: {part: table[f"{way}.{part}"] for part in ("least", "mean")}
            for way in ("to_client", "to_leader")
        },
        "least_round_trip_us": {str(k): sum(values) / len(values) for k, values in least.items()},
        "table_3": table,
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
