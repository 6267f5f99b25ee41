"""Pictures of `led-panel`: the paper's histograms, and what the cameras saw."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from capture_app.experiments.common.plots import new_figure, save
from capture_app.panel.simulated import Image

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from capture_app.experiments.led_panel.trial import Trial


def draw_led_panel(
    done: "Sequence[Trial]",
    pictures: tuple[Image, Image],
    paper: Mapping[str, Mapping[str, float]],
    folder: Path,
) -> list[Path]:
    """Draw the errors of all trials with the paper's figures, and the first trial's two pictures."""
    figure = new_figure(figsize=(13, 4))
    panels: list[tuple[str, str, list[float]]] = [
        ("total, read off the pictures", "total_us", [t.decoded_us for t in done]),
        ("clock's part", "clock_us", [t.clock_us for t in done]),
        ("phase's part", "phase_us", [t.phase_us for t in done]),
    ]
    for axes, (title, name, errors_us) in zip(figure.subplots(1, 3), panels, strict=True):
        _histogram(axes, errors_us, title)
        if name in paper:
            largest, mean = paper[name]["max"], paper[name]["mean_abs"]
            for at, style, label in ((mean, "--", "mean"), (largest, ":", "largest")):
                axes.axvline(at, color="tab:red", linestyle=style, label=f"paper, real phones: {label}")
                axes.axvline(-at, color="tab:red", linestyle=style)
            axes.set_ylim(top=1.3 * axes.get_ylim()[1])
            axes.legend(loc="upper right", fontsize="small")
    pair = pictures_figure(pictures, (10, 4))
    return [save(figure, folder / "led-panel.png"), save(pair, folder / "led-panel-pictures.png")]


def pictures_figure(pictures: tuple[Image, Image], inches: tuple[float, float]) -> "Figure":
    """Two pictures of an instant (BGR), the leader's and the client's, side by side."""
    figure = new_figure(figsize=inches)
    for axes, picture, title in zip(figure.subplots(1, 2), pictures, ("leader", "client"), strict=True):
        axes.imshow(picture[..., ::-1])
        axes.set_title(title)
        axes.set_axis_off()
    return figure


def _histogram(axes: "Axes", errors_us: Sequence[float], title: str) -> None:
    axes.hist(errors_us, bins=min(30, max(5, len(errors_us) // 4)))
    axes.set(title=f"{title}, {len(errors_us)} trials", xlabel="client minus leader, us", ylabel="trials")
