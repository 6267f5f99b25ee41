"""The tables of `phase` with the figures in them, and its pictures: injections, and how long groups take."""

from collections.abc import Sequence
from pathlib import Path
from statistics import pstdev
from typing import TYPE_CHECKING

from capture_app.experiments.common.plots import new_figure, save
from capture_app.experiments.common.result import Figures, Result, Table, quantile
from capture_app.experiments.phase.baselines import Attempt, Attempts

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PAPERS_INJECTIONS = 5.5
GROUPS = {
    "webcam": "webcams, start in 275 ms, sd 5 ms",
    "paper-phone": "the paper's phones, 700 ms, sd 58 ms",
    "steady-phone": "steady phones, 700 ms, sd 5 ms",
}
COLORS = {"uniform": "tab:blue", "aimed": "tab:orange", "aimed-with-profile": "tab:green"}


def mean_moves(attempts: Sequence[Attempt]) -> float:
    """Mean injections or restarts of the trials that arrived; nan if none did."""
    done = [attempt.moves for attempt in attempts if attempt.seconds is not None]
    return sum(done) / len(done) if done else float("nan")


def std_moves(attempts: Sequence[Attempt]) -> float:
    """Standard deviation of the same."""
    done = [attempt.moves for attempt in attempts if attempt.seconds is not None]
    return pstdev(done) if done else float("nan")


def moves_of_one(attempts: Sequence[Attempt]) -> dict[str, float]:
    """Mean, deviation and 95 % quantile of one camera's restarts, and seconds for each."""
    done = [attempt for attempt in attempts if attempt.seconds is not None]
    seconds, moves = sum(attempt.seconds or 0.0 for attempt in done), sum(attempt.moves for attempt in done)
    return {
        "mean": mean_moves(attempts),
        "std": std_moves(attempts),
        "for_95": quantile(sorted(float(attempt.moves) for attempt in done), 0.95),
        "each_s": seconds / moves if moves else float("nan"),
    }


def mean_seconds(attempts: Sequence[Attempt]) -> float:
    """Mean seconds of the trials that arrived; nan if none did."""
    done = [attempt.seconds for attempt in attempts if attempt.seconds is not None]
    return sum(done) / len(done) if done else float("nan")


def never_share(attempts: Sequence[Attempt]) -> float:
    """Share of the trials that did not arrive."""
    return sum(attempt.seconds is None for attempt in attempts) / len(attempts)


def tables(result: Result) -> tuple[Table, ...]:
    """Return the tables to print."""
    ours, old = result.ours, result.baseline
    injections = _rows(result, "injections_mean", "injection", 2)
    restarts = _rows(result, "restarts_mean", "restart", 1)
    servo: list[tuple[str, ...]] = [(name, f"{value:.1f}") for name, value in ours["servo_us"].items()]
    head = ("device", "way", "moves", "s", "baseline: moves", "s", "never")
    return (
        Table(head, injections, "One camera to 20 us (paper: 5.5 injections of 0.3 s)"),
        Table(
            ("", "restarts", "std", "for 95 %", "s each"),
            [
                (
                    name,
                    *(f"{figures[key]:.1f}" for key in ("mean", "std", "for_95")),
                    f"{figures['each_s']:.2f}",
                )
                for name, figures in (
                    ("ours", ours["one_phone_restarts"]),
                    ("the paper's way", old["one_phone_restarts"]),
                    ("paper, real phones", result.paper["one_phone_restarts"]),
                )
            ],
            "One of the paper's phones restarted into a window of 1 ms in all, half of it to each side",
        ),
        Table(head, restarts, "Cameras that can only restart, all within 1 ms to both sides"),
        Table(
            ("crystals are off by", "s"),
            [(law, f"{seconds:.0f}") for law, seconds in old["ten_phones_seconds_mean"].items()],
            "The paper's way, ten phones within 1 ms at one moment",
        ),
        Table(("held frames", "us"), servo, "Frame durations: rows of 20 us, 20 ppm"),
    )


def _rows(result: Result, kind: str, theirs: str, digits: int) -> list[tuple[str, ...]]:
    """A row for each device and way: mean moves and seconds, ours and those of the baseline `theirs`."""
    seconds = result.ours["seconds_mean"]
    return [
        (
            device,
            way,
            f"{mean:.{digits}f}",
            f"{seconds[device][way]:.{digits}f}",
            *_baseline(result.baseline, kind, device, theirs),
        )
        for device, ways in result.ours[kind].items()
        for way, mean in ways.items()
    ]


def _baseline(old: Figures, kind: str, device: str, method: str) -> tuple[str, ...]:
    if device not in old[kind]:
        return ("-", "-", "-")
    mean, seconds = old[kind][device][method], old["seconds_mean"][device][method]
    return (f"{mean:.1f}", f"{seconds:.1f}", f"{old['never_share'][device][method]:.0%}")


def draw_injections(ours: Attempts, theirs: Attempts, folder: Path) -> Path:
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


def draw_restarts(result: Result, folder: Path) -> Path:
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


def _line(axes: "Axes", seconds: Figures, kind: str, way: str, label: str, color: str) -> None:
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
