"""Figure 7 of the paper and figures 1 and 2 of its supplement, from our messages."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from capture_app.experiments.clock_filters.convergence import Convergence, Setting
from capture_app.experiments.clock_filters.paper_protocol import Message, one_way_table, quickest
from capture_app.experiments.common.paper_values import FIGURE_S2, TABLE_3
from capture_app.experiments.common.plots import new_figure, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes

NAMES = {"mean": "mean", "minimum": "minimum", "per_direction_minimum": "per direction", "ours": "ours"}
COLOURS = ("tab:blue", "tab:orange", "tab:green", "tab:red")
LONGEST_MS = 5.0


def draw_one_way(messages: Sequence[Message], path: Path) -> Path:
    """Draw the histogram of one-way times, means dashed, the paper's dotted."""
    figure = new_figure(figsize=(8, 4.5))
    axes: Axes = figure.subplots()
    table = one_way_table(messages)
    ways = {
        "leader to client": ("to_client", [m.to_client_us / 1000.0 for m in messages]),
        "client to leader": ("to_leader", [m.to_leader_us / 1000.0 for m in messages]),
    }
    for colour, (label, (name, times_ms)) in zip(COLOURS, ways.items(), strict=False):
        axes.hist(times_ms, bins=150, range=(0.0, LONGEST_MS), alpha=0.55, color=colour, label=label)
        axes.axvline(table[f"{name}.mean"] / 1000.0, color=colour, linestyle="--")
        axes.axvline(TABLE_3[f"{name}.mean"] / 1000.0, color="black", linestyle=":", linewidth=1.0)
    axes.set(
        title=f"One-way times of {len(messages):,} messages (simulated; means dashed, the paper's dotted)",
        xlabel="ms",
        ylabel="messages",
    )
    axes.legend()
    return save(figure, path)


def draw_wedge(messages: Sequence[Message], path: Path) -> Path:
    """Draw the error of each message's offset against its round trip; it lies within half of that."""
    figure = new_figure(figsize=(8, 5))
    axes: Axes = figure.subplots()
    round_trips_ms = [m.round_trip_us / 1000.0 for m in messages]
    axes.scatter(round_trips_ms, [m.offset_error_us for m in messages], s=3, alpha=0.3, linewidths=0)
    for sign in (-1.0, 1.0):
        axes.plot((0.0, 12.0), (0.0, sign * 6000.0), color="grey", linewidth=0.8)
    best, kept = quickest(messages), [m.offset_error_us for m in messages if m.round_trip_us <= 10_000.0]
    axes.axhline(sum(kept) / len(kept), color="tab:orange", linestyle="--", label="mean filter")
    axes.plot(
        best.round_trip_us / 1000.0, best.offset_error_us, "v", color="tab:red", label="least round trip"
    )
    axes.set(
        xlim=(0.0, 12.0),
        ylim=(-5000.0, 5000.0),
        title="Each message by itself (simulated; the grey lines are half the round trip)",
        xlabel="round trip, ms",
        ylabel="error of its offset, us",
    )
    axes.legend()
    return save(figure, path)


def draw_convergence(found: Mapping[Setting, Convergence], path: Path) -> Path:
    """Draw the errors of the filters after K messages, each setting by itself."""
    figure = new_figure(figsize=(12, 4.5))
    for axes, (setting, convergence) in zip(
        figure.subplots(1, len(found), sharey=True), found.items(), strict=True
    ):
        for colour, (key, label) in zip(COLOURS, NAMES.items(), strict=True):
            axes.plot(list(convergence.after), convergence.mean_abs(key), "o-", color=colour, label=label)
        for name, colour in (("mean.10000", COLOURS[0]), ("minimum.10000", COLOURS[1])):
            axes.axhline(FIGURE_S2[name], color=colour, linestyle=":", linewidth=1.0)
        axes.set(xscale="log", yscale="log", title=setting.name, xlabel="messages")
    figure.axes[0].set_ylabel("mean abs error, us (the paper's last: dotted)")
    figure.axes[0].legend()
    return save(figure, path)
