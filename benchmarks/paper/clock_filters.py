"""Clock estimators in virtual time: the paper's section 4 with its filters, ours, and other laws of delay."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from math import exp, log
from pathlib import Path

from benchmarks.paper.clock_cases import CASES, Case, CaseFigures, case_table, run_case
from benchmarks.paper.clock_changes import CASES as CHANGES
from benchmarks.paper.clock_changes import ChangeCase, ChangeFigures, change_table, run_cases
from benchmarks.paper.clock_paper import (
    MESSAGES,
    NAMES,
    Message,
    draw_convergence,
    draw_one_way,
    draw_wedge,
    least_round_trips,
    one_way_table,
    run_of_messages,
)
from benchmarks.paper.clock_trials import (
    AS_THE_PAPER,
    BY_DEFAULT,
    COUNTS,
    FIRST,
    FIRST_SECOND,
    MOST_TRIALS,
    SITUATIONS,
    Convergence,
    Coverages,
    EstimatorErrors,
    Setting,
    converge,
    measure_coverage,
    run_law_trials,
    unequal_links,
)
from benchmarks.paper.result import Outcome, Result, Table, error_figures, new_figure, save
from benchmarks.paper.trials import call_all
from benchmarks.paper.values import FIGURE_S2, LEAST_ROUND_TRIP, TABLE_3
from benchmarks.simulated.wifi_laws import LINKS_BY_LAW
from capture_app.console.terminal import talk


@dataclass(frozen=True, slots=True)
class Study:
    """All that is measured, for the figures, the tables and the pictures."""

    laws: Mapping[str, EstimatorErrors]
    messages: list[Message]
    """Of a run as the paper's."""
    convergence: Mapping[Setting, Convergence]
    coverages: Mapping[str, Coverages]
    """By law, on links whose least delays differ by chance."""

    def coverage(self, situation: str) -> float:
        """Share of the trials of all laws in which the stated 95 % held in a situation."""
        found = [by_situation[situation] for by_situation in self.coverages.values()]
        return sum(one.held for one in found) / sum(len(one.errors_us) for one in found)


def tables(study: Study) -> tuple[Table, ...]:
    """Return the tables to print: by law, by situation, by number of messages."""
    names = list(next(iter(study.laws.values())).errors_us)
    head = tuple(name.replace("_", " ") for name in names)
    by_law = [
        (
            law,
            *(f"{trials.mean_abs(name):.1f}" for name in names),
            f"{max(abs(e) for e in trials.errors_us['ours']):.1f}",
            f"{trials.gain:.2f}",
            f"{sum(trials.uncertainties_us) / len(trials.uncertainties_us):.0f}",
            f"{100 * trials.covered / len(trials.uncertainties_us):.0f}",
        )
        for law, trials in study.laws.items()
    ]
    by_count = [
        Table(
            ("messages", *head),
            [
                (str(k), *(f"{trials.mean_abs(name):.1f}" for name in names))
                for k, trials in convergence.after.items()
            ],
            f"Paper's link, {setting.name}: mean absolute error after K messages, us",
        )
        for setting, convergence in study.convergence.items()
    ]
    ours = one_way_table(study.messages)
    one_way: list[tuple[str, ...]] = [
        (value.label, f"{ours[value.name]:.0f}", f"{value.value:.0f}")
        for value in TABLE_3.values
        if value.value is not None
    ]
    by_situation = []
    for situation in SITUATIONS:
        found = [study.coverages[law][situation] for law in LINKS_BY_LAW]
        trials_of_all = sum(len(one.errors_us) for one in found)
        by_situation.append(
            (
                situation,
                *(f"{100 * one.share:.0f}" for one in found),
                f"{100 * study.coverage(situation):.1f}",
                f"{sum(abs(e) for one in found for e in one.errors_us) / trials_of_all:.0f}",
                f"{sum(sum(one.stated_us) for one in found) / trials_of_all:.0f}",
            )
        )
    return (
        Table(
            ("law", *head, "ours, largest", "minimum/ours", "ours states", "% held"),
            by_law,
            f"Mean absolute error after {FIRST} messages, us",
        ),
        Table(
            ("% held", *LINKS_BY_LAW, "all", "mean error", "ours states"),
            by_situation,
            "How often the stated 95 % holds, least delays drawn for each trial; errors in us",
        ),
        Table(("us", "ours", "paper"), one_way, "Messages of one run as the paper's, its table III"),
        *by_count,
    )


def draw_study(study: Study, folder: Path) -> list[Path]:
    """Draw the paper's three figures of messages, and the filters under each law."""
    return [
        draw_one_way(study.messages, folder / "one-way-times.png"),
        draw_wedge(study.messages, folder / "offset-against-round-trip.png"),
        draw_convergence(study.convergence, folder / "convergence.png"),
        _draw_laws(study, folder / "clock-filters.png"),
    ]


def _draw_laws(study: Study, path: Path) -> Path:
    figure = new_figure(figsize=(9, 4.5))
    axes = figure.subplots()
    width = 0.2
    for i, (key, name) in enumerate(NAMES.items()):
        places = [place + (i - 1.5) * width for place in range(len(study.laws))]
        axes.bar(places, [t.mean_abs(key) for t in study.laws.values()], width, label=name)
    axes.set_xticks(range(len(study.laws)), list(study.laws), rotation=30, ha="right")
    axes.set(yscale="log", title="300 messages under each law", ylabel="mean abs error, us")
    axes.legend()
    return save(figure, path)


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
    changes: tuple[ChangeCase, ...] = CHANGES
    change_trials: int = 10


FULL_SIZE = StudySize()
WORTH_PROCESSES = 20
"""So many trials are worth the start of other processes."""


class ClockResult(Result, frozen=True, kw_only=True):
    """The figures of the experiment, of each case, and of those in which clocks and ways change."""

    cases: list[CaseFigures]
    changes: list[ChangeFigures]


def run(
    *,
    trials: int | None,
    seed: int,
    size: StudySize = FULL_SIZE,
) -> Outcome:
    """Run it; `size` says how much is measured beside the trials of each law."""
    count = TRIALS if trials is None else trials
    few = WORTH_PROCESSES if count < WORTH_PROCESSES else 2
    talk(f"{', '.join(LINKS_BY_LAW)}: {count} trials of {FIRST} messages")
    runs = [partial(run_law_trials, link, count, f"{seed} {name}") for name, link in LINKS_BY_LAW.items()]
    laws = dict(zip(LINKS_BY_LAW, call_all(runs, few=few), strict=True))
    talk("how often the stated uncertainty holds")
    judged = [partial(_coverage, name, count, seed, size.coverage_trials) for name in LINKS_BY_LAW]
    coverages = dict(zip(LINKS_BY_LAW, call_all(judged, few=few), strict=True))
    case_trials = min(count, size.case_trials)
    talk(f"{len(size.cases)} cases in which premises fail or nearly do, {case_trials} trials each")
    found = call_all([partial(run_case, case, case_trials, str(seed)) for case in size.cases], few=few)
    times = min(count, size.change_trials)
    talk(f"{len(size.changes)} cases in which clocks or ways change, {times} trials each")
    changes = run_cases(size.changes, times, str(seed), few=few)
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
    result = _result(study, least, [case.figures() for case in found], changes, seed, count)
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
    shown = (*tables(study), case_table(result.cases), change_table(result.changes))
    return Outcome(result, shown, notes, lambda folder: draw_study(study, folder))


def _coverage(law: str, count: int, seed: int, most: int) -> Coverages:
    return measure_coverage(unequal_links(law), count, f"{seed} {law}", most=most)


def _result(
    study: Study,
    least: dict[int, list[float]],
    cases: list[CaseFigures],
    changes: list[ChangeFigures],
    seed: int,
    count: int,
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
        changes=changes,
    )
