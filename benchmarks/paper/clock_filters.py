"""Clock estimators in virtual time under seven delay laws: their errors, and the coverage of our 95 %."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

from benchmarks.paper.clock_trials import (
    FIRST,
    FIRST_SECOND,
    MOST_TRIALS,
    SITUATIONS,
    Coverages,
    EstimatorErrors,
    measure_coverage,
    run_law_trials,
    unequal_links,
)
from benchmarks.paper.result import Outcome, Result, Table, error_figures
from benchmarks.paper.trials import call_all
from benchmarks.simulated.wifi_laws import LINKS_BY_LAW
from capture_app.console.terminal import talk

TRIALS = 100
WORTH_PROCESSES = 20
"""Number of trials from which other processes are started."""


@dataclass(frozen=True, slots=True)
class Study:
    """All measurements for the figures and tables."""

    laws: Mapping[str, EstimatorErrors]
    coverages: Mapping[str, Coverages]
    """Coverage by law, on links with random asymmetry of the minimum delays."""

    def coverage(self, situation: str) -> float:
        """Return the fraction of the trials of all laws in which the stated 95 % held in a situation."""
        found = [by_situation[situation] for by_situation in self.coverages.values()]
        return sum(one.held for one in found) / sum(len(one.errors_us) for one in found)


def run(*, trials: int | None, seed: int, coverage_trials: int = MOST_TRIALS) -> Outcome:
    """Run it; `coverage_trials` is the number for each law in the situations after the first second."""
    count = TRIALS if trials is None else trials
    few = WORTH_PROCESSES if count < WORTH_PROCESSES else 2
    talk(f"{', '.join(LINKS_BY_LAW)}: {count} trials of {FIRST} messages")
    runs = [partial(run_law_trials, link, count, f"{seed} {name}") for name, link in LINKS_BY_LAW.items()]
    laws = dict(zip(LINKS_BY_LAW, call_all(runs, few=few), strict=True))
    talk("how often the stated uncertainty holds")
    judged = [partial(_coverage, name, count, seed, coverage_trials) for name in LINKS_BY_LAW]
    study = Study(laws, dict(zip(LINKS_BY_LAW, call_all(judged, few=few), strict=True)))
    result = _result(study, seed, count)
    notes = (
        f"Stated 95 % held in {100 * result.ours['coverage_95']:.1f} % of all trials of all laws; in "
        f"{100 * result.ours['coverage_95_drawn']:.1f} % where the least delays differ by chance (5 % of "
        f"half the round trip). The hard bound held in {100 * result.ours['coverage_hard_bound']:.1f} %.",
    )
    return Outcome(result, _tables(study), notes)


def _coverage(law: str, count: int, seed: int, most: int) -> Coverages:
    return measure_coverage(unequal_links(law), count, f"{seed} {law}", most=most)


def _tables(study: Study) -> tuple[Table, ...]:
    """Return the tables to print: by law, and by situation."""
    names = list(next(iter(study.laws.values())).errors_us)
    by_law = [
        (
            law,
            *(f"{trials.mean_abs(name):.1f}" for name in names),
            f"{max(abs(e) for e in trials.errors_us['ours']):.1f}",
            f"{sum(trials.uncertainties_us) / len(trials.uncertainties_us):.0f}",
            f"{100 * trials.covered / len(trials.uncertainties_us):.0f}",
        )
        for law, trials in study.laws.items()
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
            ("law", *(name.replace("_", " ") for name in names), "ours, largest", "ours states", "% held"),
            by_law,
            f"Mean absolute error after {FIRST} messages, us",
        ),
        Table(
            ("% held", *LINKS_BY_LAW, "all", "mean error", "ours states"),
            by_situation,
            "How often the stated 95 % holds, least delays drawn for each trial; errors in us",
        ),
    )


def _result(study: Study, seed: int, count: int) -> Result:
    def errors_us(name: str) -> dict[str, object]:
        return {
            "error_us": {law: error_figures(trials.errors_us[name]) for law, trials in study.laws.items()}
        }

    laws = study.laws.values()
    found = [one for by_situation in study.coverages.values() for one in by_situation.values()]
    bounded = sum(t.bounded for t in laws) + sum(one.bounded for one in found)
    judged = count * len(laws) + sum(len(one.errors_us) for one in found)
    ours = errors_us("ours") | {
        "coverage_95": sum(trials.covered for trials in laws) / (count * len(LINKS_BY_LAW)),
        "coverage_95_drawn": study.coverage(FIRST_SECOND),
        "coverage_95_by_situation": {
            situation: {law: study.coverages[law][situation].share for law in LINKS_BY_LAW}
            | {"all": study.coverage(situation)}
            for situation in SITUATIONS
        },
        "coverage_hard_bound": bounded / judged,
        "uncertainty_us": {law: sum(trials.uncertainties_us) / count for law, trials in study.laws.items()},
    }
    return Result(
        name="clock-filters",
        kind="simulated",
        seed=seed,
        trials=count,
        ours=ours,
        baseline={name: errors_us(name) for name in next(iter(laws)).errors_us if name != "ours"},
        paper={},
    )
