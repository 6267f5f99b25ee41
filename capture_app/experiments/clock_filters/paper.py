"""The paper's section 4 and the figures of its supplement that show clocks."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from capture_app.experiments.clock_filters.convergence import (
    AS_THE_PAPER,
    BY_DEFAULT,
    COUNTS,
    Convergence,
    converge,
)
from capture_app.experiments.clock_filters.paper_plots import draw_convergence, draw_one_way, draw_wedge
from capture_app.experiments.clock_filters.paper_protocol import (
    MESSAGES,
    least_round_trips,
    mean_table,
    one_way_table,
    run_of_messages,
)
from capture_app.experiments.clock_filters.trials import FIRST
from capture_app.experiments.common.paper_values import (
    FIGURE_7,
    FIGURE_S1,
    FIGURE_S2,
    LEAST_ROUND_TRIP,
    TABLE_2,
    TABLE_3,
)
from capture_app.experiments.common.reproduction import Measured, Reproduction, share_of
from capture_app.experiments.common.result import error_figures
from capture_app.experiments.common.workers import call_all

RUNS = 30
"""Of 10,000 messages; the paper has one."""
SHORT_RUNS = {300: 239, 1000: 100}
"""Of as many messages: 239 as the trials of the panel, each of which began with 300."""
SHORT = 5
"""So many of the numbers of messages after which filters are judged are small, up to 1,000."""
SIMULATED = "The link's delays, by a law that is made from the paper's own figures, and the clocks."
BEGINS = (
    "In the paper the leader begins each exchange and takes its clients in turn; so it is done here at the "
    "paper's protocol. By default our clients begin, each when it likes. What an exchange shows is the same."
)


def paper_part(*, share: float, seed: int, talk: Callable[[str], None]) -> Sequence[Reproduction]:
    """Measure Table III, the least round trips, figure 7 and the supplement's figures."""
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
            seed=seed,
            protocol=every,
            default=Measured(started, len(first), f"the first {FIRST} messages"),
            simulated=SIMULATED,
            given=tuple(name for name in TABLE_3.names if name != "messages"),
            notes=(
                BEGINS,
                "The law is made from these figures and the least round trips of 300, 1,000 and 10,000 "
                "messages. How the quickest message divides is one sample; nothing else is known of the "
                "asymmetry, which only half the least round trip bounds, and no exchange can see it.",
                f"Not put in: after {FIRST} messages the minimum filter is {panel['mean_abs']:.0f} us off on "
                f"average and {panel['max']:.0f} at most in {len(first)} trials. The paper's panel found "
                f"{TABLE_2['clock.mean']:.0f} and {TABLE_2['clock.max']:.0f} at most.",
            ),
        ),
        Reproduction(
            of=LEAST_ROUND_TRIP,
            seed=seed,
            protocol=Measured(
                {str(count): sum(values) / len(values) for count, values in least.items()},
                short[FIRST],
                f"{', '.join(f'{len(values)} runs of {count:,}' for count, values in least.items())}",
            ),
            default=None,
            simulated=SIMULATED,
            given=LEAST_ROUND_TRIP.names,
        ),
        Reproduction(
            of=FIGURE_7,
            seed=seed,
            protocol=_part_of(every, FIGURE_7.names),
            default=None,
            simulated=SIMULATED,
            given=FIGURE_7.names,
            notes=("Means and floors are the paper's; the shape between them is assumed.",),
            draw=partial(_draw, "figure-7", partial(draw_one_way, done[0])),
        ),
        Reproduction(
            of=FIGURE_S1,
            seed=seed,
            protocol=_part_of(every, FIGURE_S1.names),
            default=None,
            simulated=SIMULATED,
            given=FIGURE_S1.names,
            draw=partial(_draw, "figure-s1", partial(draw_wedge, done[0])),
        ),
        Reproduction(
            of=FIGURE_S2,
            seed=seed,
            protocol=convergence[0],
            default=convergence[1],
            simulated=SIMULATED,
            given=("mean.10000", "minimum.10000"),
            notes=(
                "Where the clocks run apart by 20 ppm all filters look back 30 s, as the engine does, and "
                "those that know no skew are off by what it adds up to.",
                f"After {FIRST} messages without skew the minimum filter is "
                f"{at_first['minimum']['mean_abs']:.0f} us off on average and "
                f"{at_first['minimum']['max']:.0f} at most, ours "
                f"{at_first['ours']['mean_abs']:.0f} and {at_first['ours']['max']:.0f} "
                f"({short[1000]} trials). In the end both stand on the asymmetry that was put in.",
            ),
            draw=partial(
                _draw, "figure-s2", partial(draw_convergence, {AS_THE_PAPER: papers, BY_DEFAULT: ours})
            ),
        ),
    ]


def _part_of(measured: Measured, names: Sequence[str]) -> Measured:
    return Measured({name: measured.values[name] for name in names}, measured.trials, measured.setup)


def _draw(name: str, draw: Callable[[Path], Path], folder: Path) -> list[Path]:
    return [draw(folder / f"{name}.png")]
