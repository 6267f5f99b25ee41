"""A node's clock where clocks or ways change in the middle: is it told what the node then says of itself?

Each case draws clocks and a link for each trial, and looks at the node ten times a second: the engine's own
node and leader, messages and all, in virtual time. Prints a table.
"""

import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from math import inf
from pathlib import Path

from benchmarks.paper.clock_trials import ASYMMETRY, DrawLink, unequal
from benchmarks.paper.result import Table
from benchmarks.paper.trials import call_all
from benchmarks.report import new_parser, print_table
from benchmarks.simulated.changing_clocks import ChangingClock, RateSpell
from benchmarks.simulated.clock_pair import START_TRUE_NS, ClockPair, LongerFrom
from benchmarks.simulated.link_spells import LAWS, recorded_laws
from benchmarks.simulated.links import DelayLaw, Link
from benchmarks.simulated.wifi_laws import LINKS_BY_LAW, LOOPBACK
from benchmarks.simulated.wireless import PAPER_LINK, GammaDelay, wireless
from capture_app.common.node_state import NodeState
from capture_app.console.terminal import print_json, print_line
from capture_app.sync.timekeeping.clock_events import ClockChanged

_S = 1_000_000_000
TOLERANCE_NS = 300_000
"""Requested clock accuracy of most cases: what WiFi reaches."""
CRYSTAL_PPM = 20.0
"""One sigma of the skew between the two clocks."""
EVENT_S, END_S = 20.0, 60.0
"""When it happens, and until when the node is looked at; since its start."""
LOOK_EVERY_NS = 100_000_000
NEAR_A_STEP_S = 2.0
"""The hard bound is not judged for so long after a clock leaves its premise, or returns to it."""
SLEW_S = 3.0
SLEWS_PPM = (3_000, 8_000, 83_333)
"""The largest is what chrony allows itself (`maxslewrate` in chrony.conf(5))."""
_CABLE = Link(GammaDelay(50_000, 60_000), GammaDelay(50_000, 60_000))
ONE_WAY_MS = (0.2, 1.0, 5.0, 20.0)
ASYMMETRIES = (0.025, 0.05, 0.1, 0.2)
WARMING_PPM_PER_S = 0.05
"""What a 95 % error bar takes for granted at most: two sigma of likely_line.DRIFT."""


def wifi(rng: random.Random) -> Link:
    """The paper's link, whose least delays differ by chance."""
    return unequal(PAPER_LINK, rng)


def any_law(rng: random.Random, share: float = ASYMMETRY) -> Link:
    """Return a link with the paper's mean delays, under one of the laws of a WiFi link."""
    return unequal(LINKS_BY_LAW[rng.choice(list(LINKS_BY_LAW))], rng, share=share)


def cable(rng: random.Random) -> Link:
    """Return a cable with a switch: 50 us in each direction, and 10 more on average."""
    return unequal(_CABLE, rng, half_ns=50_000)


def loopback(_: random.Random) -> Link:
    """Another process of the leader's machine."""
    return LOOPBACK


@dataclass(frozen=True, slots=True)
class ChangeCase:
    """What happens at EVENT_S, and from when on the node is judged."""

    name: str
    link: DrawLink
    slew_ppm: float = 0.0
    """The leader's clock is so much faster from then on, or slower."""
    slew_s: float = 1000.0
    drift_ppm_per_s: float = 0.0
    drift_from_s: float = EVENT_S
    one_way_ns: int = 0
    """Messages in one direction, drawn for each trial, take so much longer."""
    outage: bool = False
    """Nothing passes any more."""
    from_s: float = EVENT_S
    end_s: float = END_S
    tolerance_ns: int = TOLERANCE_NS

    @property
    def breaks_bound(self) -> bool:
        """Whether a clock leaves the premise of the hard bound."""
        return abs(self.slew_ppm) > 1000.0


LINKS: dict[str, DrawLink] = {"loopback": loopback, "wire": cable, "WiFi": wifi}
CASES = (
    *(
        ChangeCase(f"{ppm:,} ppm for 3 s, {name}", link, slew_ppm=ppm, slew_s=SLEW_S, end_s=40.0)
        for ppm in SLEWS_PPM
        for name, link in LINKS.items()
    ),
    *(
        ChangeCase(f"{ppm} ppm more, {name}", LINKS[name], slew_ppm=ppm)
        for ppm in (80, 30)
        for name in ("wire", "WiFi")
    ),
    *(
        ChangeCase(
            f"hold-over, warming{since}, {name}",
            LINKS[name],
            drift_ppm_per_s=WARMING_PPM_PER_S,
            drift_from_s=from_s,
            outage=True,
            from_s=EVENT_S + 10.0,
            end_s=EVENT_S + 60.0,
        )
        for since, from_s in (("", EVENT_S), (" all along", 0.0))
        for name in ("wire", "WiFi")
    ),
    *(
        ChangeCase(
            f"one way {ms:g} ms longer, {name}",
            LINKS[name],
            one_way_ns=round(ms * 1e6),
            from_s=EVENT_S + 2.0,
            end_s=EVENT_S + 80.0,
        )
        for ms in ONE_WAY_MS
        for name in ("wire", "WiFi")
    ),
    *(
        ChangeCase(f"asymmetry {100 * share:g} %", partial(any_law, share=share), from_s=5.0, end_s=30.0)
        for share in ASYMMETRIES
    ),
)
SPELLS_S = 30.0
"""Length of the trials on links whose delays come in spells, judged after 5 s."""


def spell_cases(laws: Mapping[str, DrawLink]) -> tuple[ChangeCase, ...]:
    """Return a case for each link law, in which no clock ever changes."""
    return tuple(ChangeCase(name, link, from_s=5.0, end_s=SPELLS_S) for name, link in laws.items())


SPELL_CASES = spell_cases(LAWS)
ChangeFigures = dict[str, float | str | None]


@dataclass(slots=True)
class ChangeResult:
    """What came of a case, over all its trials and moments."""

    name: str
    trials: int
    looks: int = 0
    """Moments, with or without a time map."""
    errors_us: list[float] = field(default_factory=list)
    stated_us: list[float] = field(default_factory=list)
    held: int = 0
    bounds: int = 0
    """Moments at which the hard bound is judged."""
    bounds_held: int = 0
    ready: int = 0
    false_ready: int = 0
    """Moments at which the node says ready while it is further off than its tolerance."""
    synced: int = 0
    """Moments at which its clock is synchronized, or held over with a stated error within the tolerance."""
    steps: int = 0
    """Number of reported clock steps, except near a slew."""
    rate_changes: int = 0
    """Number of reported rate changes."""
    unready_after_s: float = 0.0
    """The longest that a node said ready after the change."""

    def figures(self) -> ChangeFigures:
        """The figures of the case; the shares are from 0 to 1, those of ready are of all moments."""
        count = len(self.errors_us)
        return {
            "name": self.name,
            "trials": self.trials,
            "judged": count,
            "mean_us": sum(self.errors_us) / count if count else None,
            "max_us": max(self.errors_us, default=None),
            "stated_us": sum(self.stated_us) / count if count else None,
            "stated_95_held": self.held / count if count else None,
            "hard_bound_held": self.bounds_held / self.bounds if self.bounds else None,
            "ready": self.ready / self.looks,
            "false_ready": self.false_ready / self.looks,
            "synced": self.synced / self.looks,
            "steps": self.steps,
            "rate_changes": self.rate_changes,
            "unready_after_s": None if self.unready_after_s == inf else self.unready_after_s,
        }


def run_case(case: ChangeCase, trials: int, seed: str) -> ChangeResult:
    """Judge a case in so many trials."""
    result = ChangeResult(case.name, trials)
    for i in range(trials):
        _run_trial(case, random.Random(f"{seed} {case.name} {i}"), result)
    return result


def _run_trial(case: ChangeCase, rng: random.Random, result: ChangeResult) -> None:
    event_ns, sign = START_TRUE_NS + round(EVENT_S * _S), rng.choice((-1.0, 1.0))
    slew = RateSpell(event_ns, event_ns + round(case.slew_s * _S), sign * case.slew_ppm * 1e-6)
    leader = ChangingClock(
        0,
        0.0,
        START_TRUE_NS,
        (slew,),
        sign * case.drift_ppm_per_s,
        drift_from_true_ns=START_TRUE_NS + round(case.drift_from_s * _S),
    )
    offset_ns, skew = round(rng.uniform(-36e12, 36e12)), rng.gauss(0.0, CRYSTAL_PPM) * 1e-6
    link = case.link(rng)
    if case.one_way_ns:
        link = _longer(link, event_ns, case.one_way_ns, to_leader=rng.random() < 0.5)
    pair = ClockPair(
        link,
        ChangingClock(offset_ns, skew, START_TRUE_NS),
        leader,
        rng,
        case.tolerance_ns,
        event_ns if case.outage else None,
    )
    unready_s, was_ready = inf, False
    for at_ns in range(round(min(case.from_s, EVENT_S) * _S), round(case.end_s * _S) + 1, LOOK_EVERY_NS):
        pair.run_until(at_ns)
        at_s = at_ns / _S
        was_ready = was_ready or pair.is_ready
        if at_s > EVENT_S and not pair.is_ready:
            unready_s = min(unready_s, at_s - EVENT_S)
        if at_s >= case.from_s:
            _look(case, pair, at_s, result)
    changes = [event.jumped for event in pair.events if isinstance(event, ClockChanged)]
    result.steps += sum(changes)
    result.rate_changes += len(changes) - sum(changes)
    if was_ready:
        result.unready_after_s = max(result.unready_after_s, unready_s)


def _look(case: ChangeCase, pair: ClockPair, at_s: float, result: ChangeResult) -> None:
    result.looks += 1
    result.ready += pair.is_ready
    judged = pair.judge()
    if judged is None:
        return
    error_ns, time_map, local_ns = judged
    stated_ns = time_map.uncertainty_at(local_ns)
    # Without its leader a node cannot be told of a burst and is not ready, but its clock goes on.
    held_over = pair.node.timekeeper.time_is_known and stated_ns <= case.tolerance_ns
    result.synced += pair.node.state is NodeState.READY or held_over
    result.errors_us.append(abs(error_ns) / 1000.0)
    result.stated_us.append(stated_ns / 1000.0)
    result.held += abs(error_ns) <= stated_ns
    result.false_ready += pair.is_ready and abs(error_ns) > case.tolerance_ns
    steps_s = (EVENT_S, EVENT_S + case.slew_s) if case.breaks_bound else ()
    if not any(0.0 <= at_s - step_s < NEAR_A_STEP_S for step_s in steps_s):
        result.bounds += 1
        result.bounds_held += abs(error_ns) <= time_map.hard_bound_at(local_ns)


def _longer(link: Link, from_ns: int, extra_ns: int, *, to_leader: bool) -> Link:
    """The same link with one of its ways longer from a true time on."""

    def longer(law: DelayLaw) -> LongerFrom:
        return LongerFrom(law, from_ns, extra_ns)

    same = wireless(link)
    quick = same.quick
    if to_leader:
        quick = quick and replace(quick, to_leader=longer(quick.to_leader))
        return replace(same, to_leader=longer(same.to_leader), quick=quick)
    quick = quick and replace(quick, to_client=longer(quick.to_client))
    return replace(same, to_client=longer(same.to_client), quick=quick)


def change_table(cases: list[ChangeFigures]) -> Table:
    """Return the table of all cases."""

    def cell(value: float | str | None, scale: float = 1.0) -> str:
        return "-" if value is None else f"{scale * float(value):.1f}"

    rows = [
        (
            str(case["name"]),
            *(cell(case[name]) for name in ("mean_us", "max_us", "stated_us")),
            *(
                cell(case[name], 100.0)
                for name in ("stated_95_held", "hard_bound_held", "ready", "false_ready", "synced")
            ),
            str(case["steps"]),
            str(case["rate_changes"]),
            cell(case["unready_after_s"]),
        )
        for case in cases
    ]
    head = ("case", "mean error", "largest", "stated", "% held", "% bound held", "% ready", "% false ready")
    return Table(
        (*head, "% synced", "steps", "rate changes", "ready for s after"),
        rows,
        f"A node whose clock or way changes; errors in us, asked for {TOLERANCE_NS / 1e3:.0f}; the"
        f" bound is not judged for {NEAR_A_STEP_S:g} s from where a slew beyond its premise begins and ends",
    )


def run_cases(cases: tuple[ChangeCase, ...], trials: int, seed: str, *, few: int = 2) -> list[ChangeFigures]:
    """Judge all cases."""
    calls: list[Callable[[], ChangeResult]] = [partial(run_case, case, trials, seed) for case in cases]
    return [found.figures() for found in call_all(calls, few=few)]


def main() -> None:
    """Print the table."""
    parser = new_parser(__doc__, seed_of="all chance")
    parser.add_argument("--trials", type=int, default=10, help="trials of each case (10)")
    parser.add_argument("--spells", action="store_true", help="only links whose delays come in spells")
    parser.add_argument("--trace", type=Path, help="also a recorded link: two columns of delays in us")
    options = parser.parse_args()
    recorded = () if options.trace is None else spell_cases(recorded_laws(options.trace))
    cases = (*(() if options.spells else CASES), *SPELL_CASES, *recorded)
    found = run_cases(cases, options.trials, str(options.seed))
    if options.json:
        print_json(found)
    else:
        table = change_table(found)
        print_line(table.title)
        print_table(table.head, table.rows)


if __name__ == "__main__":
    main()
