"""The tables of the experiment `clock-filters`."""

from capture_app.experiments.clock_filters.coverage import SITUATIONS
from capture_app.experiments.clock_filters.trials import FIRST, Study
from capture_app.experiments.common.result import Table
from capture_app.simulation.network.paper_link import LINKS_BY_LAW


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
        (str(k), *(f"{trials.mean_abs(name):.1f}" for name in names))
        for k, trials in study.convergence.items()
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
        Table(("messages", *head), by_count, "Paper's link: mean absolute error after K messages, us"),
    )
