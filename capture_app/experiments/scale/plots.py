"""The picture of `scale`: how far apart two clients' clocks are, over time."""

from pathlib import Path
from typing import TYPE_CHECKING

from capture_app.experiments.common.figures import quantile
from capture_app.experiments.common.plots import new_figure, save

if TYPE_CHECKING:
    from collections.abc import Mapping

    from capture_app.experiments.scale.experiment import Run


def draw_scale(runs: "Mapping[str, Mapping[str, Run]]", seed: int, path: Path) -> Path:
    """Draw the 99 % quantile of the differences between two clients over time, for each run."""
    figure = new_figure(figsize=(9, 5))
    axes = figure.subplots()
    for shape, sizes in runs.items():
        for n, (clients, one) in enumerate(sizes.items()):
            points = [(at_s / 60.0, quantile(pairs, 0.99)) for at_s, pairs in one.pairs_us(seed)]
            style = f"C{n}-" if shape == "tree" else f"C{n}:"
            axes.plot(*zip(*points, strict=True), style, lw=1, label=f"{clients}, {shape.replace('_', ' ')}")
    axes.set(
        yscale="log",
        xlabel="minutes",
        ylabel="99 % of the differences between two clients, us",
        title="Clocks on the paper's link",
    )
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter("{x:g}")
    axes.legend(ncols=2)
    return save(figure, path)
