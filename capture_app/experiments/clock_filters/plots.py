"""Pictures of `clock-filters`: the wedge, the one-way delays, convergence, and the laws beside each other."""

from pathlib import Path
from typing import TYPE_CHECKING

from capture_app.experiments.common.plots import new_figure, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from capture_app.experiments.clock_filters.trials import Study

NAMES = {"mean": "mean", "minimum": "minimum", "per_direction_minimum": "per direction", "ours": "ours"}


def draw_study(study: "Study", path: Path) -> Path:
    """Draw four panels into one picture."""
    figure = new_figure(figsize=(12, 8))
    (wedge, delays), (convergence, laws) = figure.subplots(2, 2)
    _wedge(wedge, study)
    _delays(delays, study)
    _convergence(convergence, study)
    _laws(laws, study)
    return save(figure, path)


def _wedge(axes: "Axes", study: "Study") -> None:
    round_trips_ms = [(m.there_ns + m.back_ns) / 1e6 for m in study.messages]
    axes.scatter(round_trips_ms, study.offset_errors_us, s=2, alpha=0.3, linewidths=0)
    axes.set(
        xlim=(0, 12),
        ylim=(-5000, 5000),
        title=f"{len(study.messages)} messages",
        xlabel="round trip, ms",
        ylabel="error of the offset, us",
    )


def _delays(axes: "Axes", study: "Study") -> None:
    ways = {
        "leader to client": [m.back_ns / 1e6 for m in study.messages],
        "client to leader": [m.there_ns / 1e6 for m in study.messages],
    }
    for name, delays_ms in ways.items():
        axes.hist(delays_ms, bins=120, range=(0, 8), alpha=0.6, label=name)
    axes.set(title="one-way delays", xlabel="ms", ylabel="messages")
    axes.legend()


def _convergence(axes: "Axes", study: "Study") -> None:
    for key, name in NAMES.items():
        axes.plot(
            list(study.convergence), [t.mean_abs(key) for t in study.convergence.values()], "o-", label=name
        )
    axes.set(xscale="log", yscale="log", title="convergence", xlabel="messages", ylabel="mean abs error, us")
    axes.legend()


def _laws(axes: "Axes", study: "Study") -> None:
    width = 0.2
    for i, (key, name) in enumerate(NAMES.items()):
        places = [place + (i - 1.5) * width for place in range(len(study.laws))]
        axes.bar(places, [t.mean_abs(key) for t in study.laws.values()], width, label=name)
    axes.set_xticks(range(len(study.laws)), list(study.laws), rotation=30, ha="right")
    axes.set(yscale="log", title="300 messages under each law", ylabel="mean abs error, us")
    axes.legend()
