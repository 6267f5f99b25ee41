"""The tables of `clock-filters`, and its pictures: the wedge, one-way delays, convergence, and the laws."""

from pathlib import Path
from typing import TYPE_CHECKING

from capture_app.experiments.clock_filters.coverage import SITUATIONS
from capture_app.experiments.clock_filters.trials import FIRST, Study
from capture_app.experiments.common.plots import new_figure, save
from capture_app.experiments.common.result import Table
from capture_app.simulation.network.paper_link import LINKS_BY_LAW

if TYPE_CHECKING:
    from matplotlib.axes import Axes

NAMES = {"mean": "mean", "minimum": "minimum", "per_direction_minimum": "per direction", "ours": "ours"}


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


def draw_study(study: Study, path: Path) -> Path:
    """Draw four panels into one picture."""
    figure = new_figure(figsize=(12, 8))
    (wedge, delays), (convergence, laws) = figure.subplots(2, 2)
    _wedge(wedge, study)
    _delays(delays, study)
    _convergence(convergence, study)
    _laws(laws, study)
    return save(figure, path)


def _wedge(axes: "Axes", study: Study) -> None:
    round_trips_ms = [(m.there_ns + m.back_ns) / 1e6 for m in study.messages]
    axes.scatter(round_trips_ms, study.offset_errors_us, s=2, alpha=0.3, linewidths=0)
    axes.set(
        xlim=(0, 12),
        ylim=(-5000, 5000),
        title=f"{len(study.messages)} messages",
        xlabel="round trip, ms",
        ylabel="error of the offset, us",
    )


def _delays(axes: "Axes", study: Study) -> None:
    ways = {
        "leader to client": [m.back_ns / 1e6 for m in study.messages],
        "client to leader": [m.there_ns / 1e6 for m in study.messages],
    }
    for name, delays_ms in ways.items():
        axes.hist(delays_ms, bins=120, range=(0, 8), alpha=0.6, label=name)
    axes.set(title="one-way delays", xlabel="ms", ylabel="messages")
    axes.legend()


def _convergence(axes: "Axes", study: Study) -> None:
    for key, name in NAMES.items():
        axes.plot(
            list(study.convergence), [t.mean_abs(key) for t in study.convergence.values()], "o-", label=name
        )
    axes.set(xscale="log", yscale="log", title="convergence", xlabel="messages", ylabel="mean abs error, us")
    axes.legend()


def _laws(axes: "Axes", study: Study) -> None:
    width = 0.2
    for i, (key, name) in enumerate(NAMES.items()):
        places = [place + (i - 1.5) * width for place in range(len(study.laws))]
        axes.bar(places, [t.mean_abs(key) for t in study.laws.values()], width, label=name)
    axes.set_xticks(range(len(study.laws)), list(study.laws), rotation=30, ha="right")
    axes.set(yscale="log", title="300 messages under each law", ylabel="mean abs error, us")
    axes.legend()
