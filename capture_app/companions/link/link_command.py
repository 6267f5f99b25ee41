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
from capture_app.console.terminal import FiniteRange, answer, json_option, table, talk
from capture_app.console.usage import examples

if TYPE_CHECKING:
    from collections.abc import Sequence

    from capture_app.companions.link.link_measurement import LinkTrial


@click.command(
    short_help="Measure clock synchronization over a link.",
    epilog=examples(
        "capture-app link --serve",
        "capture-app link --connect 192.168.1.20 --trials 3",
        "capture-app link --connect 192.168.1.20 --plot figures",
    ),
)
@click.option("--serve", is_flag=True, help="Run the leader's end, until Ctrl-C.")
@click.option(
    "--host",
    default="0.0.0.0",  # noqa: S104
    help="With --serve: address to listen on.",
)
@click.option("--port", type=click.IntRange(1, 65535), default=DEFAULT_PORT, help="With --serve: UDP port.")
@click.option("--connect", type=ADDRESS, metavar="HOST:PORT", help="Run the client's end, and measure.")
@click.option(
    "--messages",
    type=click.IntRange(300, 1_000_000),
    default=300,
    help="Messages per trial; the clock counts as synchronized from 300 on.",
)
@click.option(
    "--interval-ms",
    type=FiniteRange(0.2, 10_000.0),
    metavar="MS",
    show_default="the engine's schedule: 3, 6, 12, then 25 ms",
    help="With --connect: time between messages.",
)
@click.option(
    "--true-offset-ns",
    type=int,
    default=0,
    help="True difference of the clocks, leader minus this host; 0 on one machine.",
)
@click.option("--clock", default="host", help="Clock of this end, as for `capture-app node`.")
@click.option("--emulated", is_flag=True, help="Record in the result that the link is emulated.")
@click.option(
    "--trials",
    type=click.IntRange(1, 1_000_000),
    metavar="N",
    default=10,
    help="Number of trials.",
)
@click.option(
    "--seed",
    type=click.IntRange(0, 2**63 - 1),
    metavar="N",
    default=1,
    help="Seed of the random numbers.",
)
@click.option("--plot", type=FOLDER, metavar="DIR", help="Draw figures into this folder (needs matplotlib).")
@json_option
def link(
    serve: bool,
    host: str,
    port: int,
    connect: Address | None,
    messages: int,
    interval_ms: float | None,
    true_offset_ns: int,
    clock: str,
    emulated: bool,
    trials: int,
    seed: int,
    plot: Path | None,
    as_json: bool,
) -> None:
    """Measure clock synchronization on a real link: --serve at one end, --connect at the other.

    The client's end joins as a node without a camera.

    The errors are true only if --true-offset-ns is right, as between network namespaces of one machine.
    """
    from capture_app.common.clock import parse_clock
    from capture_app.companions.link import link_measurement as measuring

    if serve is (connect is not None):
        raise click.UsageError("give either --serve or --connect HOST:PORT")
    if connect is None:
        talk(f"listening on {Address(host, port)}")
        run_until_stopped(measuring.serve(host, port))
        return
    if plot is not None:
        require_plots(plot)
    own_clock, done = parse_clock(clock, node="link"), list[measuring.LinkTrial]()

    async def measure(leader: Address) -> None:
        poll_interval_ns = None if interval_ms is None else round(interval_ms * 1e6)
        async for reached in measuring.measure(
            leader, own_clock, messages=messages, poll_interval_ns=poll_interval_ns, trials=trials, seed=seed
        ):
            done.append(measuring.judge(reached, own_clock, true_offset_ns))
            if len(done) % 10 == 0 or messages > 1000:
                talk(f"{len(done)} of {trials}: {done[-1].error_us:+.1f} us")

    asyncio.run(measure(connect))
    kind: measuring.Kind = "emulated link" if emulated else "real"
    figures = measuring.sum_up(done, kind=kind, messages=messages, seed=seed)
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
