"""Pictures of `phase`: how many injections, and how long groups take that can only restart."""

from pathlib import Path
from typing import TYPE_CHECKING

from capture_app.experiments.common.plots import new_figure, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from capture_app.experiments.common.result import Figures, Result
    from capture_app.experiments.phase.experiment import Attempts

PAPERS_INJECTIONS = 5.5
GROUPS = {
    "webcam": "webcams, start in 275 ms, sd 5 ms",
    "paper-phone": "the paper's phones, 700 ms, sd 58 ms",
    "steady-phone": "steady phones, 700 ms, sd 5 ms",
}
COLORS = {"uniform": "tab:blue", "aimed": "tab:orange", "aimed-with-profile": "tab:green"}


def draw_injections(ours: "Attempts", theirs: "Attempts", folder: Path) -> Path:
    """Draw how many injections unknown phones take to 20 us, ours and libsoftwaresync's rule."""
    figure = new_figure(figsize=(11, 4))
    axes, late = figure.subplots(1, 2)
    name = "unknown-phones"
    ways = {
        "injection-with-profile": "ours, with a profile",
        "injection": "ours, row time known",
        "injection-row-unknown": "ours, nothing known",
    }
    moves = [[w.moves for w in ours.injections[name][way] if w.seconds is not None] for way in ways]
    axes.hist(moves, bins=[n - 0.5 for n in range(13)], label=list(ways.values()))
    axes.axvline(PAPERS_INJECTIONS, color="tab:red", linestyle="--", label="paper, real phones: mean")
    axes.set(title=f"{len(moves[0])} phones to 20 us", xlabel="injections", ylabel="trials")
    axes.legend(fontsize="small")
    rule = theirs.injections[name]["injection"]
    arrived = [w.moves for w in rule if w.seconds is not None]
    late.hist(arrived, bins=range(52), color="tab:gray")
    late.set(
        title=f"libsoftwaresync's rule: {len(rule) - len(arrived)} of {len(rule)} never arrive",
        xlabel="injections of those that do",
        ylabel="trials",
    )
    return save(figure, folder / "phase-injections.png")


def draw_restarts(result: "Result", folder: Path) -> Path:
    """Draw the mean seconds by the number of cameras, for each kind; the paper's way beside ours."""
    figure = new_figure(figsize=(13, 4))
    for axes, (kind, title) in zip(figure.subplots(1, 3, sharey=True), GROUPS.items(), strict=True):
        axes.set(xscale="log", yscale="log", title=title, xlabel="cameras")
        for way, color in COLORS.items():
            _line(axes, result.ours["seconds_mean"], kind, way, f"ours, {way.replace('-', ' ')}", color)
        seconds = result.baseline["seconds_mean"]
        _line(axes, seconds, kind, "restart", "the paper's way (if it arrives)", "tab:red")
        axes.legend(fontsize="small")
        axes.grid(alpha=0.3)
    figure.axes[0].set_ylabel("mean seconds until all are within 1 ms")
    return save(figure, folder / "phase-restarts.png")


def _line(axes: "Axes", seconds: "Figures", kind: str, way: str, label: str, color: str) -> None:
    points = [
        (int(device.removeprefix(f"{kind}-x")), by_way[way])
        for device, by_way in seconds.items()
        if device.startswith(f"{kind}-x") and way in by_way
    ]
    if points:
        counts = [count for count, _ in points]
        axes.plot(counts, [mean for _, mean in points], "o-", color=color, label=label)
        axes.set_xticks(counts, [str(count) for count in counts])
        axes.set_xticks([], minor=True)
