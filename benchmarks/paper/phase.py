"""Phase alignment of cameras: injections, restarts and frame durations, beside the paper's method."""

import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from math import nan

from benchmarks.paper.phase_trials import (
    PPM,
    Attempt,
    Attempts,
    align_one_camera,
    inject_like_libsoftwaresync,
    known_profile,
    restart_like_the_paper,
    restart_together,
    unknown_phone,
)
from benchmarks.paper.result import Figures, Outcome, Result, Table
from benchmarks.paper.trials import call_all
from capture_app.console.terminal import talk
from capture_app.plugins.cameras.sim.profiles import PROFILES


def sum_up(attempts: Sequence[Attempt]) -> dict[str, float]:
    """Return moves and seconds of the successful trials, nan if none, and the fraction of failures."""
    moves = [attempt.moves for attempt in attempts if attempt.seconds is not None]
    seconds = [attempt.seconds for attempt in attempts if attempt.seconds is not None]
    return {
        "mean": sum(moves) / len(moves) if moves else nan,
        "seconds": sum(seconds) / len(seconds) if seconds else nan,
        "never": (len(attempts) - len(moves)) / len(attempts),
    }


def tables(result: Result) -> tuple[Table, ...]:
    """Return the tables to print."""
    head = ("device", "way", "moves", "s", "baseline: moves", "s", "never")
    return (
        Table(
            head,
            _rows(result, "injections_mean", "injection", 2),
            "One camera to 20 us (paper: 5.5 injections of 0.3 s)",
        ),
        Table(
            head,
            _rows(result, "restarts_mean", "restart", 1),
            "Cameras that can only restart, all within 1 ms to both sides",
        ),
    )


def _rows(result: Result, kind: str, theirs: str, digits: int) -> list[tuple[str, ...]]:
    """Return a row per device and method: mean moves and seconds, ours and the baseline's (`theirs`)."""
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


TRIALS = 20
TOLERANCE_NS = 20_000
"""Tolerance of injections, as in the paper."""
WIDE_NS = 1_000_000
"""Tolerance of groups that restart, to each side: twice the paper's window, which is 1 ms in total."""
PAPERS_WINDOW_NS = 500_000
"""Half of the paper's window, to each side: a restart succeeds with a chance of 1 ms per period."""
UNKNOWN = "unknown-phones"
GROUPS = {10: 1.0, 50: 0.02}
"""Numbers of cameras that can only restart, with the fraction of the trials for each."""
THEIRS_SHARE = 10.0
"""Factor of trials of the paper's method, which simulates no frames, up to all trials."""
THEIRS = "restart"
"""Name of the paper's method."""
PHONE = replace(
    PROFILES["webcam"],
    name="paper-phone",
    model="Phone with the paper's start latency",
    start_latency_ns=(700_000_000, 58_000_000),
    timestamp_noise_ns=3_000,
)
"""Starts in 600 to 800 ms (paper, section 5.1): the scatter covers a period, so aiming does not help."""


def run(
    *, trials: int | None, seed: int, groups: Mapping[int, float] = GROUPS, jobs: int | None = None
) -> Outcome:
    """Run it; everything is simulated, with the engine's own aligners and shared goal.

    `groups` are numbers of cameras that can only restart, with the fraction of the trials for each. `jobs` is
    the number of processes, None for one per core.
    """
    count = TRIALS if trials is None else trials
    ours, theirs = Attempts(), Attempts()
    talk("injections ...")
    phones = [(unknown_phone(random.Random(seed + n)), seed + n) for n in range(count)]
    ours.injections[UNKNOWN] = {
        "injection": [align_one_camera(p, s, TOLERANCE_NS) for p, s in phones],
        "injection-row-unknown": [align_one_camera(p, s, TOLERANCE_NS, row_known=False) for p, s in phones],
        "injection-with-profile": [
            align_one_camera(p, s, TOLERANCE_NS, known=known_profile(p)) for p, s in phones
        ],
    }
    theirs.injections[UNKNOWN] = {
        "injection": [inject_like_libsoftwaresync(p, s, TOLERANCE_NS) for p, s in phones]
    }
    talk("frame durations ...")
    ours.injections["pi"] = {
        "frame-duration": [align_one_camera(PROFILES["pi"], seed + n, TOLERANCE_NS) for n in range(count)]
    }
    for cameras, share in groups.items():
        talk(f"{cameras} cameras that can only restart ...")
        few, many = (max(2, round(min(1.0, part) * count)) for part in (share, THEIRS_SHARE * share))
        _restarts(cameras, few, many, seed, ours, theirs, jobs)
    result = Result(
        name="phase",
        kind="simulated",
        seed=seed,
        trials=count,
        ours={
            "injections_mean": _figures(ours.injections, "mean"),
            "restarts_mean": _figures(ours.restarts, "mean"),
            "seconds_mean": _figures({**ours.injections, **ours.restarts}, "seconds"),
            "group_trials": {str(cameras): max(2, round(share * count)) for cameras, share in groups.items()},
        },
        baseline={
            "injections_mean": _figures(theirs.injections, "mean"),
            "restarts_mean": _figures(theirs.restarts, "mean"),
            "seconds_mean": _figures({**theirs.injections, **theirs.restarts}, "seconds"),
            "never_share": _figures({**theirs.injections, **theirs.restarts}, "never"),
        },
        paper={},
    )
    return Outcome(result, tables(result), NOTES)


NOTES = (
    "Seconds count from the first move, for groups from the moment that all cameras know their phase.",
    "Baseline: libsoftwaresync's rule with its own constants (means over those that arrive at all), and the "
    "paper's restarts, U(0, 1 s) of sleep, each camera by itself until all are within 1 ms at one moment.",
    f"Crystals of restarted cameras are off by up to {PPM:g} ppm, drawn uniformly.",
)


def _figures(ways: Mapping[str, Mapping[str, list[Attempt]]], figure: str) -> dict[str, dict[str, float]]:
    return {
        name: {way: sum_up(done)[figure] for way, done in by_way.items()} for name, by_way in ways.items()
    }


def _restarts(
    cameras: int, few: int, many: int, seed: int, ours: Attempts, theirs: Attempts, jobs: int | None
) -> None:
    """Measure a group of webcams, and one of the paper's phones, for whose starts aiming does not help.

    `few` is the number of our trials, in which every frame is simulated, and `many` of the paper's method.
    """
    calls: dict[tuple[str, str], list[Callable[[], Attempt]]] = {}
    for profile, method in ((PROFILES["webcam"], "aimed"), (PHONE, "uniform")):
        name = f"{profile.name}-x{cameras}"
        one = partial(restart_together, profile, cameras, tolerance_ns=WIDE_NS, aimed=method == "aimed")
        calls[name, method] = [partial(one, seed=seed + n) for n in range(few)]
        calls[name, THEIRS] = [
            partial(restart_like_the_paper, profile, cameras, seed + n, WIDE_NS) for n in range(many)
        ]
    done = iter(call_all([call for trials in calls.values() for call in trials], jobs=jobs))
    for (name, method), trials in calls.items():
        ways = theirs.restarts if method == THEIRS else ours.restarts
        ways.setdefault(name, {})[method] = [next(done) for _ in trials]
