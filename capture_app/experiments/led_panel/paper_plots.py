"""Figures 5 and 6 of the paper: the panel in both phones' pictures, and the errors' histograms."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from capture_app.experiments.common.paper_values import TABLE_2
from capture_app.experiments.common.plots import new_figure, save
from capture_app.experiments.led_panel.plots import pictures_figure
from capture_app.panel.simulated import Image

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from capture_app.experiments.led_panel.trial import Trial

PARTS = {"phase": "phase", "clock": "clock", "total": "phase and clock"}
BINS = 41


def draw_histograms(trials: "Mapping[str, Sequence[Trial]]", folder: Path) -> list[Path]:
    """Draw the errors of phase, clock and both, a row for each set-up, with the paper's figures dashed."""
    figure = new_figure(figsize=(12, 3.2 * len(trials)))
    rows = figure.subplots(len(trials), len(PARTS), squeeze=False, sharex="col")
    errors_us = {
        setup: {
            "phase": [trial.phase_us for trial in done],
            "clock": [trial.clock_us for trial in done],
            "total": [trial.decoded_us for trial in done],
        }
        for setup, done in trials.items()
    }
    for column, (part, name) in enumerate(PARTS.items()):
        # The same bins in all rows, so that heights can be compared.
        all_us = [us for errors in errors_us.values() for us in errors[part]]
        reach = max(TABLE_2[f"{part}.max"], *(abs(us) for us in all_us))
        for row, setup in enumerate(trials):
            axes = rows[row][column]
            axes.hist(errors_us[setup][part], bins=BINS, range=(-reach, reach), color="tab:blue")
            axes.set_title(f"{name}, {setup}", fontsize="medium")
            _mark(axes, part)
    for axes in rows[-1]:
        axes.set_xlabel("client minus leader, µs")
    for axes_of in rows:
        axes_of[0].set_ylabel("trials")
    lines, labels = rows[0][0].get_legend_handles_labels()
    figure.legend(lines, labels, loc="outside lower center", ncols=len(labels))
    return [save(figure, folder / "figure-6.png")]


def _mark(axes: "Axes", part: str) -> None:
    """Mark the paper's mean and largest errors, to both sides."""
    for name, style in (("mean", "--"), ("max", ":")):
        at = TABLE_2[f"{part}.{name}"]
        label = "the paper's mean" if name == "mean" else "the paper's largest"
        axes.axvline(at, color="tab:red", linestyle=style, lw=1, label=label)
        axes.axvline(-at, color="tab:red", linestyle=style, lw=1)


def draw_panel(pictures: tuple[Image, Image], folder: Path) -> list[Path]:
    """Draw what the leader's phone and the client's phone see of the panel at one instant."""
    return [save(pictures_figure(pictures, (12, 4.7)), folder / "figure-5.jpg")]
