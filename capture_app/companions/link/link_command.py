"""`capture-app link`: clock errors over a link."""

import asyncio
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from capture_app.commands.shared_options import ADDRESS, FOLDER, run_until_stopped
from capture_app.common.address import DEFAULT_PORT, Address
from capture_app.common.errors import BadInputError
from capture_app.common.optional_packages import load_optional
from capture_app.common.text import count
from capture_app.console.option_rules import Rule, RuledCommand
from capture_app.console.terminal import answer, json_option, table, talk
from capture_app.console.usage import examples

if TYPE_CHECKING:
    from collections.abc import Sequence

    from capture_app.companions.link.link_measurement import LinkTrial

EVERYWHERE = Address("0.0.0.0", DEFAULT_PORT)  # noqa: S104 - nodes are other machines
MESSAGES, SEED = 300, 1
"""Messages of a trial: the clock counts as synchronized from 300 on; seed of the intervals between them."""


@click.command(
    cls=RuledCommand,
    rules=(
        Rule("", "--serve --connect"),
        Rule("--serve", "!--connect"),
        Rule("--true-offset-ns --trials --plot", "--connect"),
    ),
    short_help="Measure clock synchronization over a link.",
    epilog=examples(
        "capture-app link --serve",
        "capture-app link --connect 192.168.1.20 --trials 3",
        "capture-app link --connect 192.168.1.20 --plot figures",
    ),
)
@click.option(
    "--serve",
    type=ADDRESS,
    is_flag=False,
    flag_value=EVERYWHERE,
    metavar="[HOST:PORT]",
    help=f"Run the leader's end, until Ctrl-C; by default at {EVERYWHERE}.",
)
@click.option("--connect", type=ADDRESS, metavar="HOST:PORT", help="Run the client's end, and measure.")
@click.option(
    "--true-offset-ns",
    type=int,
    default=0,
    help="True difference of the clocks, leader minus this host; 0 on one machine.",
)
@click.option(
    "--trials",
    type=click.IntRange(1, 1_000_000),
    metavar="N",
    default=10,
    help="Number of trials.",
)
@click.option("--plot", type=FOLDER, metavar="DIR", help="Draw figures into this folder (needs matplotlib).")
@json_option
def link(
    serve: Address | None,
    connect: Address | None,
    true_offset_ns: int,
    trials: int,
    plot: Path | None,
    as_json: bool,
) -> None:
    """Measure clock synchronization on a real link: --serve at one end, --connect at the other.

    The client's end joins as a node without a camera.

    The errors are true only if --true-offset-ns is right, as between network namespaces of one machine.
    """
    from capture_app.common.clock import HostClock
    from capture_app.companions.link import link_measurement as measuring

    if serve is not None:
        talk(f"listening on {serve}")
        run_until_stopped(measuring.serve(serve.host, serve.port))
        return
    assert connect is not None
    if plot is not None:
        require_plots(plot)
    clock, done = HostClock(), list[measuring.LinkTrial]()

    async def measure(leader: Address) -> None:
        async for reached in measuring.measure(leader, clock, messages=MESSAGES, trials=trials, seed=SEED):
            done.append(measuring.judge(reached, clock, true_offset_ns))
            if len(done) % 10 == 0:
                talk(f"{len(done)} of {trials}: {done[-1].error_us:+.1f} us")

    asyncio.run(measure(connect))
    figures = measuring.sum_up(done, kind="real", messages=MESSAGES, seed=SEED)
    answer(as_json, figures, _lines(figures))
    if plot is not None:
        talk(f"drew {_draw(done, plot / 'link.png')}")


def _lines(figures: dict[str, Any]) -> Iterator[str]:
    trials = f"{count(figures['trials'], 'trial')} of {figures['messages']} messages"
    yield f"{figures['kind']}, {trials}, seed {figures['seed']}"
    columns = {"mean_abs_us": "mean abs", "max_us": "largest", "std_us": "std", "bias_us": "bias"}
    yield table(
        ("clock error, us", *columns.values()),
        [("", *(f"{figures[column]:.2f}" for column in columns))],
    )
    yield (
        f"{figures['seconds_mean']:.2f} s a trial (slowest {figures['seconds_max']:.2f} s), least round trip"
        f" {figures['min_round_trip_us']:.0f} us; the error is within the stated 95 % in"
        f" {100 * figures['coverage_95']:.0f} % of the trials, and within the hard bound in"
        f" {100 * figures['coverage_hard_bound']:.0f} %"
    )


def require_plots(folder: Path) -> None:
    """Check before the measurement that figures can be drawn into a folder, and create it.

    Raises NotAvailableError without matplotlib, BadInputError if the folder cannot be created.
    """
    load_optional("matplotlib", "plots", "drawing figures")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInputError(
            f"cannot draw into {folder}: {error.strerror}", hint="choose another folder with --plot"
        ) from None


def _draw(trials: "Sequence[LinkTrial]", path: Path) -> Path:
    """Draw each trial's clock error (us), with the stated uncertainty as its error bar; return `path`."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(layout="constrained", figsize=(8, 5))
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    errors_us, stated_us = [trial.error_us for trial in trials], [trial.uncertainty_us for trial in trials]
    axes.errorbar(range(1, len(trials) + 1), errors_us, stated_us, fmt="o", ms=3)
    axes.set(xlabel="trial", ylabel="clock error, us", title=f"{count(len(trials), 'trial')} on this link")
    figure.savefig(path, dpi=120)
    return path
