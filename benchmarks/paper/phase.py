"""Bringing cameras into phase: injections, restarts and frame durations, ours beside the paper's way."""

import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from math import nan
from pathlib import Path
from statistics import pstdev, quantiles
from typing import TYPE_CHECKING

from benchmarks.paper.phase_cases import CASES, Case, CaseFigures, case_table, run_cases
from benchmarks.paper.phase_trials import (
    PPM,
    Attempt,
    Attempts,
    S,
    align_one_camera,
    inject_like_libsoftwaresync,
    known_profile,
    restart_like_the_paper,
    restart_together,
    uniform_ppm,
    unknown_phone,
)
from benchmarks.paper.result import Figures, Outcome, Result, Table, new_figure, save
from benchmarks.paper.trials import call_all, quantile
from benchmarks.paper.values import INJECTIONS, RESTARTS
from benchmarks.simulated.aligner_bench import Bench
from capture_app.console.terminal import talk
from capture_app.simulation.profiles import PROFILES, SensorProfile

if TYPE_CHECKING:
    from matplotlib.axes import Axes


PAPERS_INJECTIONS = 5.5
GROUP_TITLES = {
    "webcam": "webcams, start in 275 ms, sd 5 ms",
    "paper-phone": "the paper's phones, 700 ms, sd 58 ms",
    "steady-phone": "steady phones, 700 ms, sd 5 ms",
}
COLORS = {"uniform": "tab:blue", "aimed": "tab:orange", "aimed-with-profile": "tab:green"}


def sum_up(attempts: Sequence[Attempt]) -> dict[str, float]:
    """Moves and seconds of the trials that arrived, nan if none did, and the share of those that did not."""
    moves = [attempt.moves for attempt in attempts if attempt.seconds is not None]
    seconds = [attempt.seconds for attempt in attempts if attempt.seconds is not None]
    return {
        "mean": sum(moves) / len(moves) if moves else nan,
        "std": pstdev(moves) if moves else nan,
        "for_95": quantile(sorted(map(float, moves)), 0.95),
        "each_s": sum(seconds) / sum(moves) if sum(moves) else nan,
        "seconds": sum(seconds) / len(seconds) if seconds else nan,
        "never": (len(attempts) - len(moves)) / len(attempts),
    }


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
    for axes, (kind, title) in zip(figure.subplots(1, 3, sharey=True), GROUP_TITLES.items(), strict=True):
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


TRIALS = 20
TOLERANCE_NS = 20_000
"""Of injections, as in the paper."""
WIDE_NS = 1_000_000
"""Of groups that restart, to each side: twice the paper's window, which is one of 1 ms in all."""
PAPERS_WINDOW_NS = 500_000
"""Half of the paper's window, to each side: a restart is accepted with a chance of 1 ms in a period."""
TEN = 10
DRIFTS: dict[str, Callable[[random.Random], float]] = {
    "up to 20 ppm": uniform_ppm,
    "sigma of 20 ppm": lambda rng: rng.gauss(0.0, PPM),
    "20 ppm either way": lambda rng: rng.choice((-PPM, PPM)),
}
"""Laws that the crystals of the paper's ten phones may have: how long they take hangs on it."""
GROUPS = {2: 1.0, 5: 1.0, 10: 1.0, 20: 0.1, 50: 0.02}
"""Numbers of cameras that can only restart, and the share of the trials that each gets."""
THEIRS_SHARE = 10.0
"""The paper's way, where no frames are simulated, gets so many times more, up to all."""
THEIRS = "restart"
"""The paper's way."""
SERVO_ROW_NS = 20_000
SERVO_S = 60
SETTLE_S = 10
PHONE = replace(
    PROFILES["webcam"],
    name="paper-phone",
    model="Phone with the paper's start latency",
    start_latency_ns=(700_000_000, 58_000_000),
    timestamp_noise_ns=3_000,
)
"""Starts in 600 to 800 ms (paper, section 5.1): the spread covers a period, so that no aim helps."""
STEADY_PHONE = replace(PHONE, name="steady-phone", start_latency_ns=(700_000_000, 5_000_000))

PAPER = {
    "injections_mean": {"phone": {"injection": INJECTIONS["moves.mean"]}},
    "restarts_mean": {"phone": {"restart": RESTARTS["tries.mean"]}},
    "seconds_mean": {
        "phone": {
            "injection": INJECTIONS["moves.mean"] * INJECTIONS["each_s"],
            "restart": RESTARTS["tries.mean"] * RESTARTS["each_s"],
        }
    },
    "injections_std": {"phone": {"injection": INJECTIONS["moves.std"]}},
    "one_phone_restarts": {
        **{name: RESTARTS[f"tries.{name}"] for name in ("mean", "std", "for_95")},
        "each_s": RESTARTS["each_s"],
    },
}


class PhaseResult(Result, frozen=True, kw_only=True):
    """The figures of the experiment, and those of each case."""

    cases: list[CaseFigures]


def run(
    *,
    trials: int | None,
    seed: int,
    groups: Mapping[int, float] = GROUPS,
    servo_s: int = SERVO_S,
    cases: tuple[Case, ...] = CASES,
    jobs: int | None = None,
) -> Outcome:
    """Run it; everything is simulated, with the engine's own aligners and shared goal.

    `groups` are numbers of cameras that can only restart, and the share of the trials that each gets;
    `servo_s` is for how long held frames are watched, `jobs` the number of processes, None for one per core.
    """
    count = TRIALS if trials is None else trials
    ours, theirs = Attempts(), Attempts()
    talk("injections ...")
    for name in ("unknown-phones", "phone-a", "phone-b"):
        phones = [(_device(name, seed + n), seed + n) for n in range(count)]
        ours.injections[name] = {
            "injection": [align_one_camera(p, s, TOLERANCE_NS) for p, s in phones],
            "injection-row-unknown": [
                align_one_camera(p, s, TOLERANCE_NS, row_known=False) for p, s in phones
            ],
            "injection-with-profile": [
                align_one_camera(p, s, TOLERANCE_NS, known=known_profile(p)) for p, s in phones
            ],
        }
        theirs.injections[name] = {
            "injection": [inject_like_libsoftwaresync(p, s, TOLERANCE_NS) for p, s in phones]
        }
    talk("frame durations ...")
    servo = _servo(max(2, count // 20), seed, servo_s)
    ours.injections["pi"] = {
        "frame-duration": [align_one_camera(PROFILES["pi"], seed + n, TOLERANCE_NS) for n in range(count)]
    }
    for cameras, share in groups.items():
        talk(f"{cameras} cameras that can only restart ...")
        few, many = (max(2, round(min(1.0, part) * count)) for part in (share, THEIRS_SHARE * share))
        _restarts(cameras, few, many, seed, ours, theirs, jobs)
    talk("one phone into the paper's window ...")
    alone = [partial(align_one_camera, PHONE, seed + n, PAPERS_WINDOW_NS) for n in range(count)]
    alone_theirs = [
        restart_like_the_paper(PHONE, 1, seed + n, PAPERS_WINDOW_NS)
        for n in range(round(THEIRS_SHARE * count))
    ]
    alone_ours = call_all(alone, jobs=jobs)
    talk("the paper's way under other laws of drift ...")
    drifts = {
        name: [restart_like_the_paper(PHONE, TEN, seed + n, WIDE_NS, crystal_ppm=law) for n in range(count)]
        for name, law in DRIFTS.items()
    }
    talk(f"{len(cases)} cases in which premises fail or nearly do, {count} trials each ...")
    result = PhaseResult(
        name="phase",
        kind="simulated",
        seed=seed,
        trials=count,
        ours={
            "injections_mean": _figures(ours.injections, "mean"),
            "injections_std": _figures(ours.injections, "std"),
            "restarts_mean": _figures(ours.restarts, "mean"),
            "one_phone_restarts": _of_one_phone(alone_ours),
            "seconds_mean": _figures({**ours.injections, **ours.restarts}, "seconds"),
            "group_trials": {str(cameras): max(2, round(share * count)) for cameras, share in groups.items()},
            "servo_us": servo,
        },
        baseline={
            "injections_mean": _figures(theirs.injections, "mean"),
            "restarts_mean": _figures(theirs.restarts, "mean"),
            "one_phone_restarts": _of_one_phone(alone_theirs),
            "seconds_mean": _figures({**theirs.injections, **theirs.restarts}, "seconds"),
            "never_share": _figures({**theirs.injections, **theirs.restarts}, "never"),
            "ten_phones_seconds_mean": {name: sum_up(ways)["seconds"] for name, ways in drifts.items()},
        },
        paper=PAPER,
        cases=run_cases(count, seed, cases=cases, jobs=jobs),
    )

    def draw(folder: Path) -> list[Path]:
        return [draw_injections(ours, theirs, folder), draw_restarts(result, folder)]

    return Outcome(result, (*tables(result), case_table(result.cases)), NOTES, draw)


NOTES = (
    "Seconds count from the first move, for groups from the moment that all cameras know their phase.",
    "Baseline: libsoftwaresync's rule with its own constants (means over those that arrive at all), and the "
    "paper's restarts, U(0, 1 s) of sleep, each camera by itself until all are within 1 ms at one moment.",
    "Cases: aligned is the share of the trials that were called aligned and were; false, of the frames "
    "called aligned, those off by over 1.5 times the tolerance, or by more than it where coarse stamps have "
    "widened it; worst, the largest error of a frame called aligned. At 300 ppm an injection cannot hold "
    "20 us: such a camera is brought to its goal for each burst, which no case shows.",
    f"Crystals of restarted cameras are off by up to {PPM:g} ppm, drawn uniformly.",
)


def _figures(ways: Mapping[str, Mapping[str, list[Attempt]]], figure: str) -> dict[str, dict[str, float]]:
    return {
        name: {way: sum_up(done)[figure] for way, done in by_way.items()} for name, by_way in ways.items()
    }


def _of_one_phone(attempts: Sequence[Attempt]) -> dict[str, float]:
    figures = sum_up(attempts)
    return {name: figures[name] for name in ("mean", "std", "for_95", "each_s")}


def _device(name: str, seed: int) -> SensorProfile:
    return unknown_phone(random.Random(seed)) if name == "unknown-phones" else PROFILES[name]


def _restarts(
    cameras: int, few: int, many: int, seed: int, ours: Attempts, theirs: Attempts, jobs: int | None
) -> None:
    """Measure a group of webcams, of the paper's phones, and of phones that start steadily.

    `few` trials of ours, in which every frame is simulated, and `many` of the paper's way.
    """
    calls: dict[tuple[str, str], list[Callable[[], Attempt]]] = {}
    for profile, methods in (
        (PROFILES["webcam"], ("uniform", "aimed", "aimed-with-profile")),
        (PHONE, ("uniform",)),
        (STEADY_PHONE, ("aimed", "aimed-with-profile")),
    ):
        name = f"{profile.name}-x{cameras}"
        for method in methods:
            aimed, known = method != "uniform", 24 if method == "aimed-with-profile" else 0
            one = partial(
                restart_together, profile, cameras, tolerance_ns=WIDE_NS, aimed=aimed, starts_known=known
            )
            calls[name, method] = [partial(one, seed=seed + n) for n in range(few)]
        calls[name, THEIRS] = [
            partial(restart_like_the_paper, profile, cameras, seed + n, WIDE_NS) for n in range(many)
        ]
    done = iter(call_all([call for trials in calls.values() for call in trials], jobs=jobs))
    for (name, method), trials in calls.items():
        ways = theirs.restarts if method == THEIRS else ours.restarts
        ways.setdefault(name, {})[method] = [next(done) for _ in trials]


def _servo(runs: int, seed: int, servo_s: int) -> dict[str, float]:
    """Absolute true errors in us of held frames: 20 us rows, 20 ppm, after the first ten seconds."""
    profile = replace(
        PROFILES["pi"],
        row_time_ns=SERVO_ROW_NS,
        frame_length_rows=round(33_333_000 / SERVO_ROW_NS),
        min_frame_rows=800,
        timestamp_noise_ns=3_000,
        outlier_share=0.01,
        drop_share=0.01,
    )
    figures: dict[str, float] = {}
    for label, noise_ns in (("", 0), ("_with_5_us_clock_noise", 5_000)):
        errors_us: list[float] = []
        for n in range(runs):
            ppm = PPM if n % 2 else -PPM
            bench = Bench(profile, seed + n, 50_000, ppm=ppm, clock_noise_ns=noise_ns)
            looks = bench.run(servo_s * S)
            errors_us += [abs(k.error_ns) / 1000 for k in looks if k.now_ns > looks[0].now_ns + SETTLE_S * S]
        cuts = quantiles(errors_us, n=100)
        figures |= {f"p50{label}": cuts[49], f"p99{label}": cuts[98], f"max{label}": max(errors_us)}
    return figures
