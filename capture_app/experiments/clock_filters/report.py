"""The tables of `clock-filters`, and its pictures: the wedge, one-way times, convergence, and the laws."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from capture_app.experiments.clock_filters.convergence import Convergence, Setting
from capture_app.experiments.clock_filters.coverage import SITUATIONS, Coverages
from capture_app.experiments.clock_filters.paper_plots import (
    NAMES,
    draw_convergence,
    draw_one_way,
    draw_wedge,
)
from capture_app.experiments.clock_filters.paper_protocol import Message, one_way_table
from capture_app.experiments.clock_filters.trials import FIRST, EstimatorErrors
from capture_app.experiments.common.paper_values import TABLE_3
from capture_app.experiments.common.plots import new_figure, save
from capture_app.experiments.common.result import Table
from capture_app.simulation.paper_link import LINKS_BY_LAW


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
