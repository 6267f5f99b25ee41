"""How far apart the clocks of clients are, with the reference broadcast and without it."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from math import hypot
from pathlib import Path
from typing import Any

from capture_app.experiments.common.plots import new_figure, save
from capture_app.experiments.common.result import Outcome, Result, Table, quantile
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
Trials = Sequence[Sequence[Moment]]


def run(
    *,
    trials: int | None,
    seed: int,
    talk: Callable[[str], None],
    cases: Mapping[str, Case] = CASES,
    seconds: int = SECONDS,
    settled_s: int = SETTLED_S,
) -> Outcome:
    """Run the cases for so many seconds on all cores; moments after `settled_s` count."""
    count = TRIALS if trials is None else trials
    talk(f"{len(cases)} cases, {count} trials of {seconds} s each ...")
    calls = [
        partial(run_trial, case, f"{seed}/{name}/{trial}", seconds)
        for name, case in cases.items()
        for trial in range(count)
    ]
    moments = call_all(calls)
    done = {name: moments[k * count : (k + 1) * count] for k, name in enumerate(cases)}
    settled = {
        name: [moment for trial in trials for moment in trial if moment.at_s > settled_s]
        for name, trials in done.items()
    }
    result = Result(
        name="reference-broadcast",
        kind="simulated",
        seed=seed,
        trials=count,
        ours={name: _figures(cases[name], one, corrected=True) for name, one in settled.items()},
        baseline={name: _figures(cases[name], one, corrected=False) for name, one in settled.items()},
        paper={},
    )
    notes = (
        f"Moments {settled_s} to {seconds} s after the start, without the reference broadcast > with it. "
        f"Receivers: a delay of their own of up to {RECEIVER_US} us, and an exponential one "
        f"with a mean of {RECEIVER_US / 2:g} us. Beacons take 0.5 ms and more to the air, the same for "
        f"all of a cell. Clocks of {SKEW_PPM:g} ppm (one sigma).",
        "Between clients: of one cell, without receivers that are always late. What is wrong in all clocks "
        "of a cell alike stays: it shows against the leader.",
    )
    return Outcome(
        result, (_table(result, cases),), notes, lambda folder: [_draw(done, cases, result, folder)]
    )


def _figures(case: Case, moments: Sequence[Moment], *, corrected: bool) -> Mapping[str, Any]:
    """Sum up the moments, with the reference broadcast or without."""
    every = [m.corrected if corrected else m.uncorrected for m in moments]
    readings = [reading for now in every for reading in now]
    figures = {
        f"{name}_us": _sizes(
            [
                now[i].error_us - now[j].error_us
                for now in every
                for i, j in case.pairs_of_good_receivers(together=together)
            ]
        )
        for name, together in (("between_clients", True), ("across_cells", False))
    }
    shares = {
        "coverage_hard_bound": [abs(r.error_us) <= r.bound_us for r in readings],
        "coverage_95": [abs(r.error_us) <= r.uncertainty_us for r in readings],
    }
    if corrected:
        shares["in_use_share"] = [us is not None for m in moments for us in m.relative_uncertainty_us]
        shares["coverage_between_clients"] = _relative_uncertainties_held(case, moments)
    return {
        **figures,
        "to_leader_us": _sizes([reading.error_us for reading in readings]),
        **{name: sum(held) / len(held) if held else None for name, held in shares.items()},
    }


def _relative_uncertainties_held(case: Case, moments: Sequence[Moment]) -> list[bool]:
    """Whether each pair of one cell was as near as their stated uncertainties say."""
    held = []
    for moment in moments:
        for i, j in case.pairs_of_good_receivers(together=True):
            one, other = moment.relative_uncertainty_us[i], moment.relative_uncertainty_us[j]
            if one is not None and other is not None:
                error_us = moment.corrected[i].error_us - moment.corrected[j].error_us
                held.append(abs(error_us) <= hypot(one, other))
    return held


def _sizes(errors: list[float]) -> Mapping[str, float] | None:
    if not errors:
        return None
    sizes = sorted(abs(error) for error in errors)
    return {"mean_abs": sum(sizes) / len(sizes), "p99": quantile(sizes, 0.99), "max": sizes[-1]}


def _table(result: Result, cases: Mapping[str, Case]) -> Table:
    rows: list[tuple[str, ...]] = []
    for name, ours in result.ours.items():
        uncorrected = result.baseline[name]

        def both(key: str, part: str, ours: Any = ours, uncorrected: Any = uncorrected) -> str:
            return "" if ours[key] is None else f"{uncorrected[key][part]:.0f} > {ours[key][part]:.0f}"

        held = ours["coverage_between_clients"]
        rows.append(
            (
                cases[name].title,
                both("between_clients_us", "mean_abs"),
                both("between_clients_us", "p99"),
                both("across_cells_us", "mean_abs"),
                both("to_leader_us", "mean_abs"),
                both("to_leader_us", "p99"),
                f"{100 * ours['in_use_share']:.0f}",
                "" if held is None else f"{100 * held:.0f}",
                f"{100 * uncorrected['coverage_95']:.0f} > {100 * ours['coverage_95']:.0f}",
                f"{100 * ours['coverage_hard_bound']:.0f}",
            )
        )
    errors = ("between clients, us: mean", "99 %", "across cells: mean", "to the leader: mean", "99 %")
    shares = ("in use, %", "apart held, %", "95 % held, %", "bound held, %")
    return Table(("clients", *errors, *shares), rows)


def _draw(done: Mapping[str, Trials], cases: Mapping[str, Case], result: Result, folder: Path) -> Path:
    figure = new_figure(figsize=(11, 4.5))
    course, sizes = figure.subplots(1, 2)
    name = next(name for name in ("drawn_links", *done) if name in done)
    moments = done[name][0]
    pairs = cases[name].pairs_of_good_receivers(together=True)
    for label, pick in (("without", "uncorrected"), ("with", "corrected")):
        farthest = [
            max(abs(now[i].error_us - now[j].error_us) for i, j in pairs)
            for now in (getattr(moment, pick) for moment in moments)
        ]
        course.plot([moment.at_s for moment in moments], farthest, label=label)
    course.set(xlabel="s", ylabel="farthest two clients, us", title=cases[name].title)
    course.legend()
    for k, (label, figures) in enumerate((("without", result.baseline), ("with", result.ours))):
        heights = [figures[case]["between_clients_us"]["mean_abs"] for case in done]
        sizes.barh([place + 0.4 * k for place in range(len(done))], heights, 0.4, label=label)
    sizes.set_yticks([place + 0.2 for place in range(len(done))], [case.replace("_", " ") for case in done])
    sizes.invert_yaxis()
    sizes.set(xlabel="mean difference of two clients of a cell, us")
    sizes.legend()
    return save(figure, folder / "reference-broadcast.png")
