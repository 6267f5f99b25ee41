"""Clients that hear the same packets, beside the same clients without: how far apart their clocks are."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from math import hypot
from pathlib import Path
from typing import Any

from capture_app.experiments.common.result import Outcome, Result, Table
from capture_app.experiments.common.workers import call_all
from capture_app.experiments.reference_broadcast.trials import (
    CASES,
    RECEIVER_US,
    SKEW_PPM,
    Case,
    Moment,
    run_trial,
)

TRIALS = 10
SECONDS, SETTLED_S = 30, 12
"""Moments after the second of these count."""
Trials = Sequence[Sequence[Moment]]


def run(*, trials: int | None, seed: int, talk: Callable[[str], None]) -> Outcome:
    """Run all cases, on all cores."""
    count = TRIALS if trials is None else trials
    talk(f"{len(CASES)} cases, {count} trials of {SECONDS} s each ...")
    calls = [
        partial(run_trial, case, f"{seed}/{name}/{trial}", SECONDS)
        for name, case in CASES.items()
        for trial in range(count)
    ]
    moments = call_all(calls)
    done = {name: moments[k * count : (k + 1) * count] for k, name in enumerate(CASES)}
    result = Result(
        name="reference-broadcast",
        kind="simulated",
        seed=seed,
        trials=count,
        ours={name: _figures(CASES[name], one, agreed=True) for name, one in done.items()},
        baseline={name: _figures(CASES[name], one, agreed=False) for name, one in done.items()},
        paper={},
    )
    return Outcome(result, (_table(result),), NOTES, lambda folder: [_draw(done, result, folder)])


NOTES = (
    f"Moments {SETTLED_S} to {SECONDS} s after the start, without what was agreed > with it. "
    f"Receivers: a delay of their own of up to {RECEIVER_US} us, and an exponential one "
    f"with a mean of {RECEIVER_US / 2:g} us. Beacons take 0.5 ms and more to the air, the same for "
    f"all of a cell. Clocks of {SKEW_PPM:g} ppm (one sigma).",
    "Between clients: of one cell, without those that hear late. What is wrong in all clocks of a cell alike "
    "stays: it is seen against the leader.",
)


def _figures(case: Case, trials: Trials, *, agreed: bool) -> Mapping[str, Any]:
    """Sum up the moments that count, with what was agreed or without."""
    moments = [moment for trial in trials for moment in trial if moment.at_s > SETTLED_S]
    every = [m.agreed if agreed else m.alone for m in moments]
    readings = [reading for now in every for reading in now]
    figures = {
        f"{name}_us": _sizes(
            [now[i].error_us - now[j].error_us for now in every for i, j in case.hear_well(together=together)]
        )
        for name, together in (("between_clients", True), ("across_cells", False))
    }
    shares = {
        "coverage_hard_bound": [abs(r.error_us) <= r.bound_us for r in readings],
        "coverage_95": [abs(r.error_us) <= r.uncertainty_us for r in readings],
    }
    if agreed:
        shares["in_use_share"] = [apart_us is not None for m in moments for apart_us in m.apart_us]
        shares["coverage_between_clients"] = _as_near_as_told(case, moments)
    return {
        **figures,
        "to_leader_us": _sizes([reading.error_us for reading in readings]),
        **{name: sum(held) / len(held) if held else None for name, held in shares.items()},
    }


def _as_near_as_told(case: Case, moments: Sequence[Moment]) -> list[bool]:
    """Of each pair of one cell that told how far apart it may be: whether it was no further."""
    held = []
    for moment in moments:
        for i, j in case.hear_well(together=True):
            one, other = moment.apart_us[i], moment.apart_us[j]
            if one is not None and other is not None:
                error_us = moment.agreed[i].error_us - moment.agreed[j].error_us
                held.append(abs(error_us) <= hypot(one, other))
    return held


def _sizes(errors: list[float]) -> Mapping[str, float] | None:
    if not errors:
        return None
    sizes = sorted(abs(error) for error in errors)
    return {"mean_abs": sum(sizes) / len(sizes), "p99": sizes[int(0.99 * len(sizes))], "max": sizes[-1]}


def _table(result: Result) -> Table:
    rows: list[tuple[str, ...]] = []
    for name, ours in result.ours.items():
        alone = result.baseline[name]

        def both(key: str, part: str, ours: Any = ours, alone: Any = alone) -> str:
            return "" if ours[key] is None else f"{alone[key][part]:.0f} > {ours[key][part]:.0f}"

        held = ours["coverage_between_clients"]
        rows.append(
            (
                CASES[name].title,
                both("between_clients_us", "mean_abs"),
                both("between_clients_us", "p99"),
                both("across_cells_us", "mean_abs"),
                both("to_leader_us", "mean_abs"),
                both("to_leader_us", "p99"),
                f"{100 * ours['in_use_share']:.0f}",
                "" if held is None else f"{100 * held:.0f}",
                f"{100 * alone['coverage_95']:.0f} > {100 * ours['coverage_95']:.0f}",
                f"{100 * ours['coverage_hard_bound']:.0f}",
            )
        )
    errors = ("between clients, us: mean", "99 %", "across cells: mean", "to the leader: mean", "99 %")
    shares = ("in use, %", "apart held, %", "95 % held, %", "bound held, %")
    return Table(("clients", *errors, *shares), rows)


def _draw(done: Mapping[str, Trials], result: Result, folder: Path) -> Path:
    from capture_app.experiments.common.plots import new_figure, save

    figure = new_figure(figsize=(11, 4.5))
    course, sizes = figure.subplots(1, 2)
    name = next(name for name in ("drawn_links", *done) if name in done)
    moments = done[name][0]
    pairs = CASES[name].hear_well(together=True)
    for label, pick in (("without", "alone"), ("with", "agreed")):
        farthest = [
            max(abs(now[i].error_us - now[j].error_us) for i, j in pairs)
            for now in (getattr(moment, pick) for moment in moments)
        ]
        course.plot([moment.at_s for moment in moments], farthest, label=label)
    course.set(xlabel="s", ylabel="farthest two clients, us", title=CASES[name].title)
    course.legend()
    for k, (label, figures) in enumerate((("without", result.baseline), ("with", result.ours))):
        heights = [figures[case]["between_clients_us"]["mean_abs"] for case in done]
        sizes.barh([place + 0.4 * k for place in range(len(done))], heights, 0.4, label=label)
    sizes.set_yticks([place + 0.2 for place in range(len(done))], [case.replace("_", " ") for case in done])
    sizes.invert_yaxis()
    sizes.set(xlabel="mean difference of two clients of a cell, us")
    sizes.legend()
    return save(figure, folder / "reference-broadcast.png")
