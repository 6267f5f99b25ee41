"""Clients that hear the same packets, beside the same clients without: how far apart their clocks are.

With and without are of one run: a client knows both what its exchanges tell and what was agreed.
"""

import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations
from math import hypot
from pathlib import Path
from typing import Any

from capture_app.experiments.result import Outcome, Result, Table
from capture_app.simulation.broadcast import Ear, RadioCell
from capture_app.simulation.clock import SimulatedClock
from capture_app.simulation.link import PAPER_LINK, DelayLaw, Link
from capture_app.simulation.profiles import PROFILES
from capture_app.simulation.rig import NodeSpec, VirtualNode, VirtualRig

TRIALS = 10
SECONDS, SETTLED_S = 30, 12
"""Instants after the second of these count."""
S, US, HOURS_NS = 1_000_000_000, 1_000, 9 * 3600 * 1_000_000_000
LEAST_US = (300.0, 900.0)
"""Least delay of each way of a link that is drawn; half the difference of the two is what nobody can see."""
TAILS_US = (1399.0, 616.0)
"""Mean delay beyond the least, to the leader and from it, as on the paper's link."""
EAR_US = 10
"""A device's own delay is drawn up to this; what comes by chance has a mean of half of it."""
SLOW_US = 400
CAMERA = replace(PROFILES["perfect"], frame_length_rows=10_000)
"""Only the clocks are looked at: ten frames a second are less work, and they are left where they are."""


@dataclass(frozen=True, slots=True)
class Case:
    """Some clients: where each one hears, and which links and ears they have."""

    title: str
    cells: tuple[RadioCell, ...]
    drawn: bool = True
    slow: int = 0
    """So many have a receiver that is always late."""


ONE, OTHER = RadioCell("one"), RadioCell("other")
CASES = {
    "paper": Case("the paper's link, all alike", (ONE,) * 5, drawn=False),
    "drawn": Case("links with asymmetries of their own", (ONE,) * 5),
    "pair": Case("the same, two clients", (ONE,) * 2),
    "slow_receiver": Case("the same, one of five hears 400 us late", (ONE,) * 5, slow=1),
    "two_cells": Case("the same, two access points", (ONE,) * 3 + (OTHER,) * 3),
    "copies": Case("the same, each is sent its own copy", (RadioCell("copies", copy_ns=300 * US),) * 5),
}


@dataclass(slots=True)
class Errors:
    """Errors in us over all trials and instants: with what was agreed, or without."""

    leader: list[float] = field(default_factory=list)
    pairs: list[float] = field(default_factory=list)
    """Of two clients of one cell that both hear as they should."""
    across: list[float] = field(default_factory=list)
    """Of two clients of different cells."""
    within_bound: int = 0
    within_95: int = 0

    def figures(self) -> Mapping[str, Any]:
        """All figures, the largest errors too."""
        return {
            "between_clients_us": _sizes(self.pairs),
            "across_cells_us": _sizes(self.across),
            "to_leader_us": _sizes(self.leader),
            "coverage_hard_bound": self.within_bound / len(self.leader),
            "coverage_95": self.within_95 / len(self.leader),
        }


@dataclass(slots=True)
class Done:
    """A case that was run: both kinds of errors, and how often two were as near as they said."""

    agreed: Errors = field(default_factory=Errors)
    alone: Errors = field(default_factory=Errors)
    told: int = 0
    apart_held: int = 0
    in_use: int = 0
    course: list[tuple[float, float, float]] = field(default_factory=list)
    """Of the first trial: time in s, largest difference in us without and with."""


def run(*, trials: int | None, seed: int, talk: Callable[[str], None]) -> Outcome:
    """Run all cases."""
    count, done = trials or TRIALS, {}
    for name, case in CASES.items():
        talk(f"{case.title} ...")
        done[name] = Done()
        for trial in range(count):
            _run_trial(case, random.Random(f"{seed}/{name}/{trial}"), done[name])
    result = Result(
        name="reference-broadcast",
        kind="simulated",
        seed=seed,
        trials=count,
        ours={name: _ours(one) for name, one in done.items()},
        baseline={name: one.alone.figures() for name, one in done.items()},
        paper={},
    )
    return Outcome(result, (_table(done),), NOTES, lambda folder: [_draw(done, folder)])


NOTES = (
    f"Instants {SETTLED_S} to {SECONDS} s after the start. Receivers: a delay of their own of up to "
    f"{EAR_US} us, and an exponential one with a mean of {EAR_US // 2} us. Beacons take 0.5 ms and more to "
    "the air, the same for all of a cell. Clocks of 20 ppm (one sigma).",
    "Between clients: of the same cell, without the one that hears late. What is wrong in all clocks of a "
    "cell alike stays: it is seen against the leader.",
)


def _run_trial(case: Case, rng: random.Random, done: Done) -> None:
    specs = [_spec(k, case, rng) for k in range(len(case.cells))]
    rig = VirtualRig(specs, seed=rng.getrandbits(32), beacons=True)
    first = not done.course
    for half_s in range(1, 2 * SECONDS + 1):
        rig.run_for(S // 2)
        # The rig has them in the order in which they started.
        nodes = [rig.nodes[spec.name] for spec in specs if spec.name in rig.nodes]
        if len(nodes) < len(specs) or any(node.client.own_map is None for node in nodes):
            continue
        if half_s > 2 * SETTLED_S:
            _judge(rig, case, nodes, done)
        if first:
            alone, agreed = (_spread_us(rig, case, nodes, own=own) for own in (True, False))
            done.course.append((half_s / 2.0, alone, agreed))


def _spec(k: int, case: Case, rng: random.Random) -> NodeSpec:
    link = PAPER_LINK
    if case.drawn:
        to_leader, to_client = (
            DelayLaw(
                least := round(rng.uniform(*LEAST_US) * US), least + round(tail * US), outlier_share=0.0064
            )
            for tail in TAILS_US
        )
        link = Link(to_leader, to_client)
    late_us = SLOW_US if k >= len(case.cells) - case.slow else 0
    return NodeSpec(
        f"client{k}",
        CAMERA,
        SimulatedClock(rng.randrange(-HOURS_NS, HOURS_NS), rng.gauss(0.0, 20.0)),
        link,
        tolerance_ns=S,
        start_true_ns=rng.randrange(S),
        cell=case.cells[k],
        ear=Ear(rng.randrange(EAR_US * US) + late_us * US, EAR_US * US // 2),
    )


def _error_us(rig: VirtualRig, node: VirtualNode, *, own: bool) -> tuple[float, float, float]:
    """Error of a clock now, its stated 95 % and its bound, all in us."""
    local_ns = node.spec.clock.local_from_true(rig.now_true_ns)
    time_map = node.client.own_map if own else node.client.time_map
    assert time_map is not None
    error_ns = time_map.leader_from_local(local_ns) - rig.now_true_ns
    return error_ns / US, time_map.uncertainty_at(local_ns) / US, time_map.hard_bound_at(local_ns) / US


def _judge(rig: VirtualRig, case: Case, nodes: list[VirtualNode], done: Done) -> None:
    hears_well = len(nodes) - case.slow
    for own, errors in ((True, done.alone), (False, done.agreed)):
        now = [_error_us(rig, node, own=own) for node in nodes]
        for error_us, uncertainty_us, bound_us in now:
            errors.leader.append(error_us)
            errors.within_95 += abs(error_us) <= uncertainty_us
            errors.within_bound += abs(error_us) <= bound_us
        for i, j in combinations(range(hears_well), 2):
            together = case.cells[i] == case.cells[j]
            (errors.pairs if together else errors.across).append(now[i][0] - now[j][0])
            if own or not together:
                continue
            apart_us = [_apart_us(rig, nodes[k]) for k in (i, j)]
            if None not in apart_us:
                done.told += 1
                done.apart_held += abs(now[i][0] - now[j][0]) <= hypot(
                    *(a for a in apart_us if a is not None)
                )
    done.in_use += sum(_apart_us(rig, node) is not None for node in nodes)


def _apart_us(rig: VirtualRig, node: VirtualNode) -> float | None:
    told_ns = node.client.report(node.spec.clock.local_from_true(rig.now_true_ns)).apart_ns
    return None if told_ns is None else told_ns / US


def _spread_us(rig: VirtualRig, case: Case, nodes: list[VirtualNode], *, own: bool) -> float:
    first = case.cells[0]
    errors = [
        _error_us(rig, node, own=own)[0]
        for k, node in enumerate(nodes)
        if case.cells[k] == first and k < len(nodes) - case.slow
    ]
    return max(errors) - min(errors)


def _sizes(errors: list[float]) -> Mapping[str, float] | None:
    if not errors:
        return None
    sizes = sorted(abs(error) for error in errors)
    return {
        "mean_abs": sum(sizes) / len(sizes),
        "p99": sizes[int(0.99 * len(sizes))],
        "max": sizes[-1],
    }


def _ours(done: Done) -> Mapping[str, Any]:
    return {
        **done.agreed.figures(),
        "in_use_share": done.in_use / len(done.agreed.leader),
        "coverage_between_clients": done.apart_held / done.told if done.told else None,
    }


def _table(done: Mapping[str, Done]) -> Table:
    rows = []
    for name, one in done.items():
        ours, alone = _ours(one), one.alone.figures()
        cells = []
        for key in ("between_clients_us", "across_cells_us", "to_leader_us"):
            for part in ("mean_abs", "p99"):
                cells += ["-" if f[key] is None else f"{f[key][part]:.0f}" for f in (alone, ours)]
        if ours["across_cells_us"] is None:
            cells[4:8] = [""] * 4
        held = ours["coverage_between_clients"]
        shares = (
            f"{100 * ours['in_use_share']:.0f}",
            "-" if held is None else f"{100 * held:.0f}",
            f"{100 * alone['coverage_95']:.0f}",
            f"{100 * ours['coverage_95']:.0f}",
            f"{100 * ours['coverage_hard_bound']:.0f}",
        )
        del cells[6:8]
        rows.append((CASES[name].title, *cells, *shares))
    head = (
        "error, us (without > with)",
        "between clients: mean",
        ">",
        "99 %",
        ">",
        "across cells: mean",
        ">",
    )
    tail = (
        "to the leader: mean",
        ">",
        "99 %",
        ">",
        "in use, %",
        "apart held, %",
        "95 % held, %",
        ">",
        "bound held, %",
    )
    return Table((*head, *tail), rows)


def _draw(done: Mapping[str, Done], folder: Path) -> Path:
    from capture_app.experiments.plots import new_figure, save

    figure = new_figure(figsize=(11, 4.5))
    course, sizes = figure.subplots(1, 2)
    times, alone, agreed = zip(*done["drawn"].course, strict=True)
    course.plot(times, alone, label="without")
    course.plot(times, agreed, label="with")
    course.set(xlabel="s", ylabel="farthest two clients, us", title="five clients, links of their own")
    course.legend()
    for k, (label, pick) in enumerate((("without", "alone"), ("with", "agreed"))):
        heights = [_mean_abs(getattr(one, pick).pairs) for one in done.values()]
        sizes.barh([place + 0.4 * k for place in range(len(done))], heights, 0.4, label=label)
    sizes.set_yticks([place + 0.2 for place in range(len(done))], [name.replace("_", " ") for name in done])
    sizes.invert_yaxis()
    sizes.set(xlabel="mean difference of two clients of a cell, us")
    sizes.legend()
    return save(figure, folder / "reference-broadcast.png")


def _mean_abs(errors: list[float]) -> float:
    return sum(map(abs, errors)) / len(errors)
