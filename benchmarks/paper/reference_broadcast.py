"""How far apart the clocks of clients are, with the reference broadcast and without it."""

import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import hypot
from pathlib import Path
from typing import Any

from benchmarks.paper.result import Outcome, Result, Table, new_figure, save
from benchmarks.paper.trials import call_all, quantile
from benchmarks.simulated.radio_cells import BeaconRig, HearingNode, RadioCell, Receiver
from benchmarks.simulated.virtual_rig import VirtualNode, VirtualRig
from benchmarks.simulated.wireless import PAPER_LINK, GammaDelay
from capture_app.common.clock import SimulatedClock
from capture_app.console.terminal import talk
from capture_app.simulation.links import Link
from capture_app.simulation.profiles import PROFILES
from capture_app.sync.clock.time_map import TimeMap

S, US, HOURS_NS = 1_000_000_000, 1_000, 9 * 3600 * 1_000_000_000
EVERY_NS = S // 2
LEAST_US = (300.0, 900.0)
"""Least delay of each way of a link that is drawn; half the difference of the two cannot be measured."""
TAILS_US = (1399.0, 616.0)
"""Mean delay beyond the least, to the leader and from it: as the paper's beyond its quickest message."""
FAR_TOO_LATE = 0.0064
RECEIVER_US = 10
"""A receiver's own delay is drawn up to this; what comes by chance has a mean of half of it."""
LATE_US = 400
SKEW_PPM = 20.0
CAMERA = replace(PROFILES["perfect"], frame_length_rows=10_000)
"""Only the clocks are looked at: ten frames a second are less work, and they are left where they are."""


@dataclass(frozen=True, slots=True)
class Case:
    """Some clients: the radio cell of each, their links and receivers."""

    title: str
    cells: tuple[RadioCell, ...]
    drawn: bool = True
    late_receivers: int = 0
    """So many, the last ones, have a receiver that is always late."""

    def pairs_of_good_receivers(self, *, together: bool) -> list[tuple[int, int]]:
        """Pairs of clients without late receivers, of one cell or of two."""
        well = range(len(self.cells) - self.late_receivers)
        return [(i, j) for i in well for j in well if i < j and (self.cells[i] == self.cells[j]) is together]


ONE, OTHER, COPYING = RadioCell("one"), RadioCell("other"), RadioCell("copying", copy_ns=300 * US)
CASES = {
    "paper_link": Case("five on the paper's link", (ONE,) * 5, drawn=False),
    "drawn_links": Case("five on links of their own", (ONE,) * 5),
    "pair": Case("the same, only two", (ONE,) * 2),
    "slow_receiver": Case("the same, one of five hears 400 us late", (ONE,) * 5, late_receivers=1),
    "two_cells": Case("the same, two access points", (ONE,) * 3 + (OTHER,) * 3),
    "copies": Case("the same, each is sent its own copy", (COPYING,) * 5),
}


@dataclass(frozen=True, slots=True)
class Reading:
    """A clock's error, its stated 95 % and its bound, in us."""

    error_us: float
    uncertainty_us: float
    bound_us: float


@dataclass(frozen=True, slots=True)
class Moment:
    """All clients at one moment: their clocks before and after the correction, and what they state of it."""

    at_s: float
    uncorrected: tuple[Reading, ...]
    corrected: tuple[Reading, ...]
    relative_uncertainty_us: tuple[float | None, ...]


def run_trial(case: Case, seed: str, seconds: int) -> list[Moment]:
    """Let some clients start within a second; return the moments of so long at which all know the time."""
    rng = random.Random(seed)
    specs = [_draw_spec(k, case, rng) for k in range(len(case.cells))]
    rig = BeaconRig(specs, seed=rng.getrandbits(32))
    moments = []
    for _ in range(seconds * S // EVERY_NS):
        rig.run_for(EVERY_NS)
        # The rig has them in the order in which they started.
        nodes = [rig.nodes[spec.name] for spec in specs if spec.name in rig.nodes]
        if len(nodes) == len(specs) and all(
            node.client.time.timekeeper.uncorrected_map is not None for node in nodes
        ):
            moments.append(_observe(rig, nodes))
    return moments


def _draw_spec(k: int, case: Case, rng: random.Random) -> HearingNode:
    link: Link = PAPER_LINK
    if case.drawn:
        to_leader_us, to_client_us = TAILS_US
        link = Link(_draw_delay(to_leader_us, rng), _draw_delay(to_client_us, rng))
    late_us = LATE_US if k >= len(case.cells) - case.late_receivers else 0
    return HearingNode(
        f"client{k}",
        CAMERA,
        SimulatedClock(rng.randrange(-HOURS_NS, HOURS_NS), rng.gauss(0.0, SKEW_PPM)),
        link,
        tolerance_ns=S,
        start_true_ns=rng.randrange(S),
        cell=case.cells[k],
        receiver=Receiver(rng.randrange(RECEIVER_US * US) + late_us * US, RECEIVER_US * US // 2),
    )


def _draw_delay(tail_us: float, rng: random.Random) -> GammaDelay:
    least_ns = round(rng.uniform(*LEAST_US) * US)
    return GammaDelay(least_ns, least_ns + round(tail_us * US), outlier_share=FAR_TOO_LATE)


def _observe(rig: VirtualRig, nodes: list[VirtualNode]) -> Moment:
    reports = [node.client.report(node.spec.clock.local_from_true(rig.now_true_ns)) for node in nodes]
    relative_ns = [report.relative_uncertainty_ns for report in reports]
    return Moment(
        rig.now_true_ns / S,
        tuple(_read_clock(rig, node, node.client.time.timekeeper.uncorrected_map) for node in nodes),
        tuple(_read_clock(rig, node, node.client.time_map) for node in nodes),
        tuple(None if ns is None else ns / US for ns in relative_ns),
    )


def _read_clock(rig: VirtualRig, node: VirtualNode, time_map: TimeMap | None) -> Reading:
    assert time_map is not None
    local_ns = node.spec.clock.local_from_true(rig.now_true_ns)
    error_ns = time_map.leader_from_local(local_ns) - rig.now_true_ns
    return Reading(
        error_ns / US, time_map.uncertainty_at(local_ns) / US, time_map.hard_bound_at(local_ns) / US
    )


TRIALS = 10
SECONDS, SETTLED_S = 30, 12
Trials = Sequence[Sequence[Moment]]


def run(
    *,
    trials: int | None,
    seed: int,
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
