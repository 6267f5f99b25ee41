"""Whether a node that says ready is: clocks that are slewed, and clocks at rest, on many links.

The engine's own node and leader, messages and all, in virtual time; the node is looked at ten times a second.
The first table is of slews that begin after a while. The second is of cameras on links at rest. `--nodes`
prints one of large rigs: some nodes, which ask as rarely as a leader of so many accepts.
"""

import random
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from math import inf
from pathlib import Path
from statistics import fmean

from benchmarks.clock.clock_changes import cable, loopback, wifi
from benchmarks.paper.clock_trials import DrawLink
from benchmarks.paper.trials import call_all, quantile
from benchmarks.report import Columns, new_parser, print_rows
from benchmarks.simulated.changing_clocks import ChangingClock, RateSpell
from benchmarks.simulated.clock_pair import START_TRUE_NS, ClockPair
from benchmarks.simulated.link_spells import LAWS, recorded_laws
from benchmarks.simulated.virtual_rig import NodeSpec, VirtualRig
from capture_app.common.clock import SimulatedClock
from capture_app.common.node_state import NodeState
from capture_app.console.terminal import print_json, print_line
from capture_app.plugins.cameras.sim.profiles import PROFILES
from capture_app.sync.rig.client import Client, ClientConfig
from capture_app.sync.rig.leader_engine import LeaderConfig
from capture_app.sync.timekeeping.clock_events import ClockChanged, ClockRateUnusual
from capture_app.sync.wire.datagrams import CLOCK, Report

S = 1_000_000_000
LOOK_EVERY_NS = 100_000_000
SLEW_FROM_S, AFTER_S = 40.0, 60.0
"""Begin of a slew, and the time from its end until which the node is looked at."""
PLL_S = 30.0
"""Time constant of a kernel's own discipline (a phase-locked loop), which corrects 1 ms."""
SAMPLED, JOIN_WITHIN_S, LARGE_S = 40, 2.0, 40.0
"""Simulated nodes of a large rig, the time within which all start, and for how long they are looked at."""
Figures = dict[str, float | str | None]


@dataclass(frozen=True, slots=True)
class Slew:
    """A slew of a node's clock in ppm for some seconds; 0 for none. A discipline fades (`PLL_S`)."""

    ppm: float = 0.0
    seconds: float = 0.0
    fades: bool = False

    def __str__(self) -> str:
        if self.fades:
            return "discipline, 1 ms"
        return f"{self.ppm:,.0f} ppm, {self.seconds:.0f} s" if self.ppm else "none"

    def spells(self, sign: float) -> tuple[RateSpell, ...]:
        """Return the spells of a clock that is so slewed from SLEW_FROM_S on."""
        begin_ns, rate = START_TRUE_NS + round(SLEW_FROM_S * S), sign * self.ppm * 1e-6
        if not self.fades:
            return (RateSpell(begin_ns, begin_ns + round(self.seconds * S), rate),)
        return tuple(
            RateSpell(begin_ns + k * S, begin_ns + (k + 1) * S, rate * 0.5 ** (k / (PLL_S / 4.0)))
            for k in range(round(self.seconds))
        )


QUICK_SLEWS = Slew(), Slew(500.0, 15.0), Slew(3_000.0, 3.0)
SLEWS = (*QUICK_SLEWS, Slew(1_500.0, 10.0), Slew(80.0, 15.0), Slew(30.0, 15.0), Slew(90.0, 30.0, fades=True))
QUICK_LINKS = "wire", "paper", "bufferbloat", "the same, 20 times as often"


@dataclass(slots=True)
class Looks:
    """What was seen of one slew on one link; errors and bars in us."""

    errors: list[float] = field(default_factory=list)
    bars: list[float] = field(default_factory=list)
    held: list[bool] = field(default_factory=list)
    held_in_slew: list[bool] = field(default_factory=list)
    false_s: float = 0.0
    """The longest in a trial that the node was ready while further off than the accuracy it is held to."""
    false_after_s: float = 0.0
    """The same, from the slew's end on."""
    again_s: float = 0.0
    """The longest from the slew's end until the node was ready and as accurate as requested."""
    alarms: int = 0
    changes: int = 0
    ready: int = 0


def default_node(rng: random.Random) -> Client[None]:
    """Return the node of a camera with default options, whose timekeeping is judged."""
    return Client(ClientConfig("camera", 1, CLOCK), rng)


def run_slew(name: str, link: DrawLink, slew: Slew, seeds: range, quiet_s: float) -> Figures:
    """Judge a slew of the node's clock on a link, or a clock at rest for `quiet_s`."""
    looks, begin, end = Looks(), SLEW_FROM_S, SLEW_FROM_S + slew.seconds
    until_s = end + AFTER_S if slew.ppm else quiet_s
    for seed in seeds:
        rng = random.Random(f"{name} {seed}")
        sign = rng.choice((-1.0, 1.0))
        clock = ChangingClock(round(rng.uniform(-36e12, 36e12)), rng.gauss(0.0, 20e-6), START_TRUE_NS)
        leader = ChangingClock(0, 0.0, START_TRUE_NS, slew.spells(sign))
        pair = ClockPair(link(rng), clock, leader, rng, None)
        keeper = pair.node.timekeeper
        keeper.target = default_node(rng).timekeeper.target
        false_s = false_after_s = 0.0
        was_ready: bool | None = None
        again_s = inf
        for k in range(round(until_s * S / LOOK_EVERY_NS)):
            pair.run_until(k * LOOK_EVERY_NS)
            judged, at_s = pair.judge(), k * LOOK_EVERY_NS / S
            if at_s < 5.0 or (slew.ppm and at_s < begin):
                continue
            looks.ready += pair.is_ready
            looks.changes += was_ready is not None and pair.is_ready is not was_ready
            was_ready = pair.is_ready
            if judged is None:
                continue
            error_ns, time_map, local_ns = judged
            bar_ns = time_map.uncertainty_at(local_ns)
            looks.errors.append(abs(error_ns) / 1e3)
            looks.bars.append(bar_ns / 1e3)
            looks.held.append(abs(error_ns) <= bar_ns)
            if begin <= at_s < end:
                looks.held_in_slew.append(looks.held[-1])
            is_false = abs(error_ns) > (keeper.target.target_ns or 0.0)
            if pair.is_ready and not is_false and at_s >= end:
                again_s = min(again_s, at_s - end)
            if pair.is_ready and is_false:
                false_s += LOOK_EVERY_NS / S
                false_after_s += LOOK_EVERY_NS / S if at_s > end else 0.0
        looks.false_s, looks.false_after_s = (
            max(looks.false_s, false_s),
            max(looks.false_after_s, false_after_s),
        )
        looks.again_s = max(looks.again_s, again_s)
        looks.alarms += sum(isinstance(event, ClockChanged | ClockRateUnusual) for event in pair.events)
    seconds = len(seeds) * (until_s - (begin if slew.ppm else 5.0))
    return {
        "link": name,
        "slew": str(slew),
        "mean_us": fmean(looks.errors),
        "max_us": max(looks.errors),
        "bar_us": fmean(looks.bars),
        "held": fmean(looks.held),
        "held_in_slew": fmean(looks.held_in_slew) if looks.held_in_slew and slew.ppm else None,
        "false_s": looks.false_s,
        "false_after_s": looks.false_after_s,
        "again_s": looks.again_s if slew.ppm and looks.again_s < inf else None,
        "ready": looks.ready * LOOK_EVERY_NS / S / seconds,
        "changes_per_min": looks.changes * 60.0 / seconds,
        "alarms_per_h": None if slew.ppm else looks.alarms * 3600.0 / seconds,
    }


CLOCK_COLUMNS: Columns = {
    "link": ("link", ""),
    "slew": ("slew", ""),
    "mean_us": ("mean error, us", ".0f"),
    "max_us": ("largest", ".0f"),
    "bar_us": ("stated", ".0f"),
    "held": ("held", ".1%"),
    "held_in_slew": ("in the slew", ".0%"),
    "false_s": ("falsely ready, s", ".1f"),
    "false_after_s": ("after its end", ".1f"),
    "again_s": ("ready again after, s", ".1f"),
    "ready": ("ready", ".1%"),
    "changes_per_min": ("changes a minute", ".2f"),
    "alarms_per_h": ("alarms an hour", ".1f"),
}


def _draw_node(name: str, link: DrawLink, rng: random.Random) -> NodeSpec:
    clock = SimulatedClock(round(rng.uniform(1e12, 9e12)), rng.gauss(0.0, 20.0))
    return NodeSpec(name, PROFILES["pi"], clock, link(rng), None)


def _reports(rig: VirtualRig) -> dict[str, Report]:
    """Return what each node says of itself now."""
    now_ns = rig.now_true_ns
    return {
        name: node.client.report(node.spec.clock.local_from_true(now_ns)) for name, node in rig.nodes.items()
    }


def run_rig(name: str, link: DrawLink, seed: int, minutes: float, cameras: int = 3) -> Figures:
    """Judge a rig of cameras with default options on a link at rest: is it ready, and what does it say?"""
    rng = random.Random(f"rig {name} {seed}")
    rig = VirtualRig([_draw_node(f"cam{k}", link, rng) for k in range(cameras)], seed=seed)
    rig.run_until(rig.all_ready, limit_ns=30 * S)
    first_s, texts, apart_us = rig.now_true_ns / S, Counter[str](), list[float]()
    states: dict[str, NodeState] = {}
    changes = ready = looks = 0
    while rig.now_true_ns < minutes * 60 * S:
        rig.run_for(LOOK_EVERY_NS)
        looks += 1
        ready += rig.all_ready()
        for name_of, report in _reports(rig).items():
            changes += states.get(name_of, report.state) is not report.state
            states[name_of] = report.state
            texts[_without_digits(f"{report.state}: {report.message}")] += 1
        if looks % 50 == 0:
            apart_us.append(_apart_ns(rig) / 1e3)
    return {
        "link": name,
        "first_s": first_s,
        "ready": ready / looks,
        "changes_per_min": changes / cameras * 60.0 / (looks * LOOK_EVERY_NS / S),
        "apart_us": fmean(apart_us),
        "apart_max_us": max(apart_us),
        "texts": " | ".join(f"{text} ({count})" for text, count in texts.most_common()),
    }


def run_large(name: str, link: DrawLink, seed: int, nodes: int, tolerance_us: float | None) -> Figures:
    """Return when SAMPLED nodes are ready that ask at the rate of `nodes`; the tolerance is their clocks'."""
    rng = random.Random(f"large {name} {nodes} {seed}")
    specs = [
        replace(
            _draw_node(f"cam{k}", link, rng),
            clock_tolerance_ns=None if tolerance_us is None else round(tolerance_us * 1e3),
            start_true_ns=round(rng.uniform(0.0, JOIN_WITHIN_S) * S),
        )
        for k in range(SAMPLED)
    ]
    rig = VirtualRig(specs, seed=seed, exchanges_per_s=LeaderConfig(1, 0).exchanges_per_s * SAMPLED / nodes)
    ready_s: dict[str, float] = {}
    ready: set[str] = set()
    while rig.now_true_ns < LARGE_S * S:
        rig.run_for(LOOK_EVERY_NS)
        ready = {node for node, report in _reports(rig).items() if report.state is NodeState.READY}
        ready_s = dict.fromkeys(ready, rig.now_true_ns / S) | ready_s
    waits = sorted([*ready_s.values(), *[inf] * (SAMPLED - len(ready_s))])
    return {
        "link": name,
        "nodes": nodes,
        "median_s": quantile(waits, 0.5),
        "most_s": quantile(waits, 0.9),
        "all_s": waits[-1],
        "ready": len(ready) / SAMPLED,
    }


def _without_digits(text: str) -> str:
    return "".join("#" if letter.isdigit() else letter for letter in text).replace("##", "#")


def _apart_ns(rig: VirtualRig) -> float:
    """Return how far apart the cameras' frames really are, ns: the widest pair."""
    period_ns = PROFILES["pi"].period_ns
    newest = [node.client.ring.nearest(2**62) for node in rig.nodes.values()]
    starts = [frame.start_true_ns for _, frame in filter(None, newest)]
    offsets = [(start - starts[0] + period_ns // 2) % period_ns for start in starts]
    return max(offsets) - min(offsets)


RIG_COLUMNS: Columns = {
    "link": ("three cameras", ""),
    "first_s": ("first ready, s", ".1f"),
    "ready": ("all ready", ".1%"),
    "changes_per_min": ("changes a minute and camera", ".2f"),
    "apart_us": ("frames apart, us", ".0f"),
    "apart_max_us": ("largest", ".0f"),
}


LARGE_COLUMNS: Columns = {
    "link": (f"{SAMPLED} nodes", ""),
    "nodes": ("at the rate of", ","),
    "median_s": ("half ready after, s", ".1f"),
    "most_s": ("90 %", ".1f"),
    "all_s": ("all", ".1f"),
    "ready": (f"ready after {LARGE_S:.0f} s", ".0%"),
}


def main() -> None:
    """Print the tables."""
    parser = new_parser(__doc__, seed_of="all chance")
    parser.add_argument("--seeds", type=int, default=5, help="trials of each case (5)")
    parser.add_argument("--quick", action="store_true", help="two seeds, few links and slews")
    parser.add_argument("--trace", type=Path, help="also a recorded link: two columns of delays in us")
    parser.add_argument("--minutes", type=float, default=12.0, help="minutes of a link at rest, a seed (12)")
    parser.add_argument("--link", action="append", help="only this link; may be repeated")
    parser.add_argument("--no-rig", action="store_true", help="only clocks")
    parser.add_argument("--nodes", type=int, action="append", help="only large rigs; may be repeated")
    parser.add_argument("--clock-tolerance-us", type=float, help="of large rigs (by default their links')")
    parser.add_argument("--at-rest", action="store_true", help="no slews")
    options = parser.parse_args()
    laws: dict[str, DrawLink] = {"wire": cable, "loopback": loopback, "paper": wifi, **LAWS}
    names = options.link or ([*QUICK_LINKS] if options.quick else [*laws])
    if options.trace is not None:
        laws |= recorded_laws(options.trace)
        names += [] if options.link else [name for name in laws if name.startswith("recording, ")]
    if options.quick:
        options.seeds, options.minutes = 2, 2.0
    if options.nodes is not None:
        large = [
            partial(run_large, name, laws[name], options.seed, n, options.clock_tolerance_us)
            for name in names
            for n in options.nodes
        ]
        rows = call_all(large, few=2)
        print_json({"large": rows}) if options.json else print_rows(rows, LARGE_COLUMNS)
        return
    slews = QUICK_SLEWS if options.quick else SLEWS
    seeds = range(options.seed, options.seed + options.seeds)
    calls: list[Callable[[], Figures]] = [
        partial(run_slew, name, laws[name], slew, seeds, options.minutes * 60.0)
        for name in names
        for slew in (slews[:1] if options.at_rest else slews)
    ]
    clocks = call_all(calls, few=2)
    rigs = (
        [] if options.no_rig else [run_rig(name, laws[name], options.seed, options.minutes) for name in names]
    )
    if options.json:
        print_json({"clocks": clocks, "rigs": rigs})
        return
    print_rows(clocks, CLOCK_COLUMNS)
    if rigs:
        print_rows(rigs, RIG_COLUMNS)
        for rig in rigs:
            print_line(f"{rig['link']}: {rig['texts']}")


if __name__ == "__main__":
    main()
