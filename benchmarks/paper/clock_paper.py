"""The paper's section 4, and the figures of its supplement that show clocks."""

import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import mean

from benchmarks.paper.clock_trials import (
    AS_THE_PAPER,
    BY_DEFAULT,
    COUNTS,
    FIRST,
    Convergence,
    Setting,
    converge,
)
from benchmarks.paper.reproduction import Measured, Reproduction
from benchmarks.paper.result import error_figures, new_figure, save
from benchmarks.paper.trials import call_all, share_of
from benchmarks.paper.values import FIGURE_S2, LEAST_ROUND_TRIP, TABLE_2, TABLE_3
from benchmarks.simulated.links import START_TRUE_NS, TURNAROUND_NS
from benchmarks.simulated.wireless import LATE_NS, PAPER_LINK, POLL_INTERVAL_NS
from capture_app.console.terminal import talk

MESSAGES = 10_000


@dataclass(frozen=True, slots=True)
class Message:
    """One-way times of a message and its answer, in us."""

    to_client_us: float
    to_leader_us: float

    @property
    def round_trip_us(self) -> float:
        """Sum of both directions."""
        return self.to_client_us + self.to_leader_us

    @property
    def offset_error_us(self) -> float:
        """Offset error of an estimate from this message alone."""
        return (self.to_client_us - self.to_leader_us) / 2.0


def run_of_messages(seed: str, count: int = MESSAGES) -> list[Message]:
    """Simulate a run on the paper's link: leader-initiated messages at the paper's rate, without losses."""
    channel, rng, found = PAPER_LINK.open(), random.Random(seed), []
    for sent_ns in range(START_TRUE_NS, START_TRUE_NS + count * POLL_INTERVAL_NS, POLL_INTERVAL_NS):
        for there_ns in channel.deliveries("to_client", sent_ns, rng)[:1]:
            answered_ns = sent_ns + there_ns + TURNAROUND_NS
            for back_ns in channel.deliveries("to_leader", answered_ns, rng)[:1]:
                found.append(Message(there_ns / 1000.0, back_ns / 1000.0))
    return found


def quickest(messages: Sequence[Message]) -> Message:
    """Return the message with the minimum round trip."""
    return min(messages, key=lambda message: message.round_trip_us)


def one_way_table(messages: Sequence[Message]) -> Mapping[str, float]:
    """Return Table III of a run, by the names of `TABLE_3`; in us."""
    kept = [message for message in messages if message.round_trip_us <= LATE_NS / 1000.0]
    best = quickest(messages)
    to_client_us, to_leader_us = mean(m.to_client_us for m in kept), mean(m.to_leader_us for m in kept)
    return {
        "to_client.mean": to_client_us,
        "to_leader.mean": to_leader_us,
        "difference.mean": abs(to_client_us - to_leader_us),
        "round_trip.mean": to_client_us + to_leader_us,
        "bias.mean": abs(to_client_us - to_leader_us) / 2.0,
        "to_client.least": best.to_client_us,
        "to_leader.least": best.to_leader_us,
        "difference.least": abs(best.to_client_us - best.to_leader_us),
        "round_trip.least": best.round_trip_us,
        "bias.least": abs(best.offset_error_us),
        "messages": float(len(messages)),
        "left_out": float(len(messages) - len(kept)),
    }


def mean_table(tables: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Return the mean figures of several runs."""
    return {name: mean(table[name] for table in tables) for name in tables[0]}


def least_round_trips(seed: str, counts: Mapping[int, int]) -> dict[int, list[float]]:
    """Return the minimum round trips in us of runs by length; `counts` is the number of runs of each."""
    return {
        count: [quickest(run_of_messages(f"{seed} {count} {i}", count)).round_trip_us for i in range(runs)]
        for count, runs in counts.items()
    }


NAMES = {"mean": "mean", "minimum": "minimum", "per_direction_minimum": "per direction", "ours": "ours"}
COLOURS = ("tab:blue", "tab:orange", "tab:green", "tab:red")


def draw_convergence(found: Mapping[Setting, Convergence], path: Path) -> Path:
    """Draw the errors of the filters after K messages, one panel for each setting."""
    figure = new_figure(figsize=(12, 4.5))
    for axes, (setting, convergence) in zip(
        figure.subplots(1, len(found), sharey=True), found.items(), strict=True
    ):
        for colour, (key, label) in zip(COLOURS, NAMES.items(), strict=True):
            axes.plot(list(convergence.after), convergence.mean_abs(key), "o-", color=colour, label=label)
        for name, colour in (("mean.10000", COLOURS[0]), ("minimum.10000", COLOURS[1])):
            axes.axhline(FIGURE_S2[name], color=colour, linestyle=":", linewidth=1.0)
        axes.set(xscale="log", yscale="log", title=setting.name, xlabel="messages")
    figure.axes[0].set_ylabel("mean abs error, us (the paper's last: dotted)")
    figure.axes[0].legend()
    return save(figure, path)


RUNS = 30
"""Number of runs of 10,000 messages; the paper has one."""
SHORT_RUNS = {300: 239, 1000: 100}
"""Number of runs by length: 239 as the panel's trials, each of which began with 300 messages."""
SHORT = 5
"""Number of the message counts up to 1,000 at which filters are judged."""
SIMULATED = (
    "The clocks, and the link's delays by a distribution made from these figures and the round trips below."
)
BEGINS = "By default each client asks, not the leader in turn; an exchange gives the same information."


def paper_part(*, share: float, seed: int) -> Sequence[Reproduction]:
    """Measure Table III, the minimum round trips, figure 7 and the supplement's figures."""
    runs = share_of(RUNS, share)
    talk(f"{runs} runs of {MESSAGES} messages")
    done = [run_of_messages(f"{seed} run {i}") for i in range(runs)]
    table = mean_table([one_way_table(messages) for messages in done])
    short = {count: share_of(times, share, least=10) for count, times in SHORT_RUNS.items()}
    first = [run_of_messages(f"{seed} first {i}", FIRST) for i in range(short[FIRST])]
    started = mean_table([one_way_table(messages) for messages in first])
    least = least_round_trips(str(seed), short | {MESSAGES: runs})
    few = max(2, runs // 2)
    talk(f"convergence, {short[1000]} short and {few} long runs, twice")
    settings = (AS_THE_PAPER, BY_DEFAULT)
    calls = [
        partial(converge, setting, counts, times, f"{seed} converge")
        for setting in settings
        for counts, times in ((COUNTS[:SHORT], short[1000]), (COUNTS[SHORT:], few))
    ]
    parts = call_all(calls)
    papers, ours = (Convergence(one.after | other.after) for one, other in (parts[:2], parts[2:]))
    at_first = {name: error_figures(papers.after[FIRST].errors_us[name]) for name in ("minimum", "ours")}
    every = Measured(table, runs, f"{MESSAGES:,} messages in 34.3 s")
    convergence = [
        Measured(
            {
                "mean.10000": found.after[MESSAGES].mean_abs("mean"),
                "minimum.10000": found.after[MESSAGES].mean_abs("minimum"),
                "ours.10000": found.after[MESSAGES].mean_abs("ours"),
                "minimum.300": found.after[FIRST].mean_abs("minimum"),
                "ours.300": found.after[FIRST].mean_abs("ours"),
            },
            few,
            setting.name,
        )
        for setting, found in zip(settings, (papers, ours), strict=True)
    ]
    panel = error_figures([one_way_table(messages)["bias.least"] for messages in first])
    return [
        Reproduction(
            of=TABLE_3,
            protocol=every,
            default=Measured(started, len(first), f"the first {FIRST} messages"),
            simulated=SIMULATED,
            given=tuple(name for name in TABLE_3.names if name != "messages"),
            notes=(
                BEGINS,
                f"Not an input: after {FIRST} messages the minimum filter is {panel['mean_abs']:.0f} us off "
                f"on average and {panel['max']:.0f} at most in {len(first)} trials. The paper's panel found "
                f"{TABLE_2['clock.mean']:.0f} and {TABLE_2['clock.max']:.0f} at most.",
            ),
        ),
        Reproduction(
            of=LEAST_ROUND_TRIP,
            protocol=Measured(
                {str(count): sum(values) / len(values) for count, values in least.items()},
                short[FIRST],
                f"{', '.join(f'{len(values)} runs of {count:,}' for count, values in least.items())}",
            ),
            default=None,
            simulated="As in Table III.",
            given=LEAST_ROUND_TRIP.names,
        ),
        Reproduction(
            of=FIGURE_S2,
            protocol=convergence[0],
            default=convergence[1],
            simulated="As in Table III.",
            given=("mean.10000", "minimum.10000"),
            notes=(
                "With a skew, all filters use the last 30 s; those without a skew term are off by its drift.",
                f"After {FIRST} messages without skew the minimum filter is "
                f"{at_first['minimum']['mean_abs']:.0f} us off on average and "
                f"{at_first['minimum']['max']:.0f} at most, ours "
                f"{at_first['ours']['mean_abs']:.0f} and {at_first['ours']['max']:.0f} "
                f"({short[1000]} trials).",
            ),
            draw=partial(draw_convergence, {AS_THE_PAPER: papers, BY_DEFAULT: ours}),
        ),
    ]
