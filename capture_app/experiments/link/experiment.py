"""The engine's own client on a real link, between two processes, beside other filters on the same samples."""

import asyncio
import random
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

from capture_app.clock import HostClock, NodeClock
from capture_app.experiments.clock_filters.filters import estimator_family
from capture_app.experiments.common.paper_values import FIGURE_S2
from capture_app.experiments.common.result import Kind, Outcome, Result, Table, error_figures
from capture_app.experiments.link.ends import JOIN_TIMEOUT_S, LinkClient, Synchronization, synchronize
from capture_app.net.address import Address
from capture_app.sync.timekeeping.poll_schedule import PACE_NS

if TYPE_CHECKING:
    from collections.abc import Mapping

TRIALS = 10
MESSAGES = 300
GAP_S = 0.25
"""Between two trials the link is idle for so long: it may be slower at first."""
PAPER = {name: {"error_us": {"bias": FIGURE_S2[f"{name}.10000"]}} for name in ("mean", "minimum")}


@dataclass(frozen=True, slots=True)
class LinkOptions:
    """What to measure: clients that join anew for each trial, until they have `messages` samples.

    They ask as the engine does by itself, or each `pace_ns`. `true_offset_ns` is the leader's clock minus the
    host clock of this process, which is known where both share one kernel; `clock` is this end's own, perhaps
    simulated.
    """

    address: Address
    messages: int = MESSAGES
    pace_ns: int | None = None
    true_offset_ns: int = 0
    clock: NodeClock = field(default_factory=HostClock)
    kind: Kind = "real"
    join_timeout_s: float = JOIN_TIMEOUT_S


@dataclass(frozen=True, slots=True)
class Trial:
    """Errors of each estimator in us at the end of one trial, and what ours claims."""

    errors_us: dict[str, float]
    uncertainty_us: float
    hard_bound_us: float
    seconds: float
    sent: int
    round_trip_us: float


def run(options: LinkOptions, *, trials: int | None, seed: int, talk: Callable[[str], None]) -> Outcome:
    """Measure from this end; the other runs `serve`. Raises NetworkError."""
    count = TRIALS if trials is None else trials
    return report(options, asyncio.run(measure(options, count, seed, talk)), seed)


def report(options: LinkOptions, done: list[Trial], seed: int) -> Outcome:
    """Sum up trials."""
    result = _result(options, done, seed)

    def draw(folder: Path) -> list[Path]:
        return [_draw(done, folder / "link.png")]

    notes = (
        f"{options.messages} messages in {median(t.seconds for t in done):.2f} s (median; slowest "
        f"{max(t.seconds for t in done):.2f} s), least round trip "
        f"{min(t.round_trip_us for t in done):.0f} us.",
        f"Stated 95 % held in {100 * result.ours['coverage_95']:.0f} % of the trials, the hard bound in "
        f"{100 * result.ours['coverage_hard_bound']:.0f} %.",
    )
    return Outcome(result, (_table(done),), notes, draw)


async def measure(options: LinkOptions, count: int, seed: int, talk: Callable[[str], None]) -> list[Trial]:
    """Let so many clients join and synchronize, one after the other. Raises NetworkError."""
    trials = []
    rng = random.Random(f"{seed} link")
    pace_ns = PACE_NS if options.pace_ns is None else options.pace_ns
    timeout_s = 10.0 + 5.0 * options.messages * pace_ns / 1e9
    for i in range(count):
        link = LinkClient(rng, options.messages, options.pace_ns)
        reached = await synchronize(
            options.address, options.clock, link, timeout_s=timeout_s, join_timeout_s=options.join_timeout_s
        )
        trials.append(judge(options, reached))
        if (i + 1) % 10 == 0 or options.messages > 1000:
            talk(f"{i + 1} of {count}: ours {trials[-1].errors_us['ours']:+.1f} us")
        await asyncio.sleep(GAP_S)
    return trials


def judge(options: LinkOptions, reached: Synchronization) -> Trial:
    """Compare the engine's map, and others from the same samples, with the truth when the last one came."""
    others = {name: estimator for name, estimator in estimator_family().items() if name != "ours"}
    for sample in reached.samples:
        for estimator in others.values():
            estimator.add(sample)
    local_ns = max(sample.t3_ns for sample in reached.samples)
    true_ns = options.clock.true_from_local(local_ns) + options.true_offset_ns
    ours = reached.time_map
    maps = {name: estimator.time_map(local_ns) for name, estimator in others.items()} | {"ours": ours}
    errors_us = {
        name: (time_map.leader_from_local(local_ns) - true_ns) / 1000.0
        for name, time_map in maps.items()
        if time_map is not None
    }
    return Trial(
        errors_us=errors_us,
        uncertainty_us=ours.uncertainty_at(local_ns) / 1000.0,
        hard_bound_us=ours.hard_bound_at(local_ns) / 1000.0,
        seconds=reached.seconds,
        sent=reached.requests,
        round_trip_us=ours.round_trip_ns / 1000.0,
    )


def _result(options: LinkOptions, trials: list[Trial], seed: int) -> Result:
    def errors(name: str) -> "Mapping[str, float]":
        return error_figures([trial.errors_us[name] for trial in trials])

    ours = errors("ours")
    names = [name for name in trials[0].errors_us if name != "ours"]
    inside = [abs(t.errors_us["ours"]) <= t.uncertainty_us for t in trials]
    bounded = [abs(t.errors_us["ours"]) <= t.hard_bound_us for t in trials]
    return Result(
        name="link",
        kind=options.kind,
        seed=seed,
        trials=len(trials),
        ours={
            "error_us": ours,
            "seconds_mean": sum(t.seconds for t in trials) / len(trials),
            "seconds_max": max(t.seconds for t in trials),
            "messages": options.messages,
            "sent_mean": sum(t.sent for t in trials) / len(trials),
            "least_round_trip_us": min(t.round_trip_us for t in trials),
            "uncertainty_us": sum(t.uncertainty_us for t in trials) / len(trials),
            "coverage_95": sum(inside) / len(trials),
            "coverage_hard_bound": sum(bounded) / len(trials),
            "share_of_minimum": ours["mean_abs"] / max(errors("minimum")["mean_abs"], 1e-9),
        },
        baseline={name: {"error_us": errors(name)} for name in names},
        paper=PAPER,
    )


def _table(trials: list[Trial]) -> Table:
    rows = []
    for name in trials[0].errors_us:
        figures = error_figures([trial.errors_us[name] for trial in trials])
        cells = (f"{figures[key]:.2f}" for key in ("mean_abs", "max", "std", "bias"))
        rows.append((name.replace("_", " "), *cells))
    return Table(("error, us", "mean abs", "largest", "std", "bias"), rows)


def _draw(trials: list[Trial], path: Path) -> Path:
    from capture_app.experiments.common.plots import new_figure, save

    figure = new_figure(figsize=(8, 5))
    axes = figure.subplots()
    for name in ("minimum", "per_direction_minimum", "ours"):
        axes.plot([t.errors_us[name] for t in trials], "o", ms=3, label=name.replace("_", " "))
    axes.set(xlabel="trial", ylabel="error, us", title=f"{len(trials)} trials on this link")
    axes.legend()
    return save(figure, path)
