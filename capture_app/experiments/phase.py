"""Bringing cameras into phase: injections, restarts and frame durations, ours beside the paper's way."""

import random
from collections.abc import Callable, Sequence
from dataclasses import replace
from statistics import quantiles

from capture_app.experiments.phase_trials import (
    S,
    Way,
    align,
    inject_like_libsoftwaresync,
    learned,
    reset_like_the_paper,
    reset_together,
    unknown_phone,
)
from capture_app.experiments.result import Outcome, Result, Table
from capture_app.simulation.bench import Bench
from capture_app.simulation.profiles import PROFILES
from capture_app.simulation.sensor import SensorProfile

TRIALS = 100
TOLERANCE_NS = 20_000
"""Of injections, as in the paper."""
WIDE_NS = 1_000_000
"""Of restarts, as in the paper."""
PPM = 20.0
"""Crystals are off by up to this; those that inject have 15 ppm of standard deviation."""
GROUPS = {2: 1.0, 5: 0.3, 10: 0.2, 20: 0.05, 50: 0.02}
"""Numbers of cameras that can only restart, and the share of the trials that each gets."""
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
    "injections_mean": {"phone": {"injection": 5.5}},
    "restarts_mean": {"phone": {"restart": 28.7}},
    "seconds_mean": {"phone": {"injection": 5.5 * 0.3, "restart": 28.7 * 1.23}},
}


def run(*, trials: int | None, seed: int, talk: Callable[[str], None]) -> Outcome:
    """Run it; everything is simulated, with the engine's own aligners and agreement."""
    count = TRIALS if trials is None else trials
    moves: dict[str, dict[str, float]] = {}
    restarts: dict[str, dict[str, float]] = {}
    seconds: dict[str, dict[str, float]] = {}
    old: dict[str, dict[str, dict[str, float]]] = {
        "injections_mean": {},
        "restarts_mean": {},
        "seconds_mean": {},
        "never_share": {},
    }
    talk("injections ...")
    for name in ("unknown-phones", "phone-a", "phone-b"):
        profiles = [_device(name, seed + n) for n in range(count)]
        ways = {
            "injection": [align(p, seed + n, TOLERANCE_NS) for n, p in enumerate(profiles)],
            "injection-row-unknown": [
                align(p, seed + n, TOLERANCE_NS, row_known=False) for n, p in enumerate(profiles)
            ],
            "injection-with-profile": [
                align(p, seed + n, TOLERANCE_NS, known=learned(p)) for n, p in enumerate(profiles)
            ],
        }
        moves[name] = {way: _mean_moves(done) for way, done in ways.items()}
        seconds[name] = {way: _mean_seconds(done) for way, done in ways.items()}
        theirs = [inject_like_libsoftwaresync(p, seed + n, TOLERANCE_NS) for n, p in enumerate(profiles)]
        old["injections_mean"][name] = {"injection": _mean_moves(theirs)}
        old["seconds_mean"][name] = {"injection": _mean_seconds(theirs)}
        old["never_share"][name] = {"injection": sum(w.seconds is None for w in theirs) / count}
    talk("frame durations ...")
    servo = _servo(max(2, count // 20), seed)
    ways_pi = [align(PROFILES["pi"], seed + n, TOLERANCE_NS) for n in range(count)]
    moves["pi"] = {"frame-duration": _mean_moves(ways_pi)}
    seconds["pi"] = {"frame-duration": _mean_seconds(ways_pi)}
    for cameras, share in GROUPS.items():
        talk(f"{cameras} cameras that can only restart ...")
        _restarts(cameras, max(2, round(share * count)), count, seed, restarts, seconds, old)
    result = Result(
        name="phase",
        kind="simulated",
        seed=seed,
        trials=count,
        ours={
            "injections_mean": moves,
            "restarts_mean": restarts,
            "seconds_mean": seconds,
            "servo_us": servo,
        },
        baseline=old,
        paper=PAPER,
    )
    return Outcome(result, tables=_tables(result), notes=NOTES)


NOTES = (
    "Seconds count from the first move, for groups from the moment that all cameras know their phase.",
    "Baseline: libsoftwaresync's rule with its own constants (means over those that arrive at all), and the "
    "paper's restarts, U(0, 1 s) of sleep, each camera by itself until all are within 1 ms at one moment.",
    f"Crystals of restarted cameras are off by up to {PPM:g} ppm, drawn uniformly.",
)


def _device(name: str, seed: int) -> SensorProfile:
    return unknown_phone(random.Random(seed)) if name == "unknown-phones" else PROFILES[name]


def _restarts(
    cameras: int,
    ours: int,
    theirs: int,
    seed: int,
    restarts: dict[str, dict[str, float]],
    seconds: dict[str, dict[str, float]],
    old: dict[str, dict[str, dict[str, float]]],
) -> None:
    """Measure a group of webcams, of the paper's phones, and of phones that start steadily."""
    for profile, methods in (
        (PROFILES["webcam"], ("uniform", "aimed", "aimed-with-profile")),
        (PHONE, ("uniform",)),
        (STEADY_PHONE, ("aimed", "aimed-with-profile")),
    ):
        name = f"{profile.name}-x{cameras}"
        restarts[name], seconds[name] = {}, {}
        for method in methods:
            ways = [
                reset_together(
                    profile,
                    cameras,
                    PPM,
                    seed + n,
                    WIDE_NS,
                    aimed=method != "uniform",
                    starts_known=24 if method == "aimed-with-profile" else 0,
                )
                for n in range(ours)
            ]
            restarts[name][method] = _mean_moves(ways)
            seconds[name][method] = _mean_seconds(ways)
        before = [reset_like_the_paper(profile, cameras, PPM, seed + n, WIDE_NS) for n in range(theirs)]
        old["restarts_mean"][name] = {"restart": _mean_moves(before)}
        old["seconds_mean"][name] = {"restart": _mean_seconds(before)}
        old["never_share"][name] = {"restart": sum(w.seconds is None for w in before) / theirs}


def _servo(runs: int, seed: int) -> dict[str, float]:
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
            looks = bench.run(SERVO_S * S)
            errors_us += [abs(k.error_ns) / 1000 for k in looks if k.now_ns > looks[0].now_ns + SETTLE_S * S]
        cuts = quantiles(errors_us, n=100)
        figures |= {f"p50{label}": cuts[49], f"p99{label}": cuts[98], f"max{label}": max(errors_us)}
    return figures


def _mean_moves(ways: Sequence[Way]) -> float:
    done = [way.moves for way in ways if way.seconds is not None]
    return sum(done) / len(done) if done else float("nan")


def _mean_seconds(ways: Sequence[Way]) -> float:
    done = [way.seconds for way in ways if way.seconds is not None]
    return sum(done) / len(done) if done else float("nan")


def _tables(result: Result) -> tuple[Table, ...]:
    ours, old = result.ours, result.baseline
    injections = [
        (
            device,
            method,
            f"{mean:.2f}",
            f"{ours['seconds_mean'][device][method]:.2f}",
            *_baseline(old, "injections_mean", device, "injection"),
        )
        for device, methods in ours["injections_mean"].items()
        for method, mean in methods.items()
    ]
    restarts = [
        (
            device,
            method,
            f"{mean:.1f}",
            f"{ours['seconds_mean'][device][method]:.1f}",
            *_baseline(old, "restarts_mean", device, "restart"),
        )
        for device, methods in ours["restarts_mean"].items()
        for method, mean in methods.items()
    ]
    servo: list[tuple[str, ...]] = [(name, f"{value:.1f}") for name, value in ours["servo_us"].items()]
    head = ("device", "way", "moves", "s", "baseline: moves", "s", "never")
    return (
        Table(head, injections, "One camera to 20 us (paper: 5.5 injections of 0.3 s)"),
        Table(
            head, restarts, "Cameras that can only restart, all within 1 ms (paper: 28.7 of 1.23 s for one)"
        ),
        Table(("held frames", "us"), servo, "Frame durations: rows of 20 us, 20 ppm"),
    )


def _baseline(
    old: "dict[str, dict[str, dict[str, float]]] | object", kind: str, device: str, method: str
) -> tuple[str, ...]:
    assert isinstance(old, dict)
    if device not in old[kind]:
        return ("-", "-", "-")
    mean, seconds = old[kind][device][method], old["seconds_mean"][device][method]
    return (f"{mean:.1f}", f"{seconds:.1f}", f"{old['never_share'][device][method]:.0%}")
