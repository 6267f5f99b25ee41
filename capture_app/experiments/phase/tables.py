"""The tables of the experiment `phase`, and the figures in them."""

from collections.abc import Sequence

from capture_app.experiments.common.result import Figures, Result, Table
from capture_app.experiments.phase.baselines import Attempt


def mean_moves(attempts: Sequence[Attempt]) -> float:
    """Mean injections or restarts of the trials that arrived; nan if none did."""
    done = [attempt.moves for attempt in attempts if attempt.seconds is not None]
    return sum(done) / len(done) if done else float("nan")


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
            head, restarts, "Cameras that can only restart, all within 1 ms (paper: 28.7 of 1.23 s for one)"
        ),
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
