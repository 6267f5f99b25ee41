"""`capture-app experiment`: the paper's tables and ours."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from capture_app.cli import LazyGroup
from capture_app.commands.experiment.options import experiment_options
from capture_app.commands.experiment.paper import paper
from capture_app.commands.options import AddressType, run_until_stopped
from capture_app.experiments import EXPERIMENTS, load
from capture_app.net.address import DEFAULT_PORT, Address
from capture_app.terminal import FiniteRange, print_json, print_line, print_table, talk
from capture_app.usage import examples

if TYPE_CHECKING:
    from capture_app.experiments import Experiment
    from capture_app.experiments.common.result import Outcome


def plain_command(name: str, text: str, load_experiment: "Callable[[], Experiment]") -> click.Command:
    """Make the command of an experiment without options of its own; `text` is its help."""

    @click.command(name=name, help=text, epilog=examples(f"capture-app experiment {name}"))
    @experiment_options
    def command(**shared: Any) -> None:
        run_experiment(load_experiment().run, **shared)

    return command


def run_experiment(
    run: "Callable[..., Outcome]", *, trials: int | None, seed: int, plot: Path | None, as_json: bool
) -> None:
    """Run an experiment with the options that all share, print its outcome and draw its pictures."""
    outcome = run(trials=trials, seed=seed, talk=talk)
    result = outcome.result
    if as_json:
        print_json(result)
    else:
        print_line(f"{result.name}: {result.kind}, {result.trials} trials, seed {result.seed}")
        for table in outcome.shown():
            print_line(f"\n{table.title}" if table.title else "")
            print_table(table.head, table.rows)
        for note in outcome.notes:
            print_line(f"\n{note}")
    if plot is not None and outcome.draw is not None:
        for path in outcome.draw(plot):
            talk(f"drew {path}")


@click.command(
    name="clock-filters",
    epilog=examples(
        "capture-app experiment clock-filters --trials 10",
        "capture-app experiment clock-filters --trace delays.csv --plot figures",
    ),
)
@experiment_options
@click.option(
    "--trace",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="CSV",
    help="Also replay the delays of this recording (columns t_s, rtt_ms).",
)
def clock_filters(trace: Path | None, **shared: Any) -> None:
    """Simulate clock estimators: the paper's filters and ours under seven delay distributions."""
    from capture_app.experiments.clock_filters.experiment import run

    run_experiment(partial(run, trace=trace), **shared)


@click.command(
    name="scale",
    epilog=examples(
        "capture-app experiment scale", "capture-app experiment scale --clients 100 --minutes 10 --shape tree"
    ),
)
@click.option(
    "--clients",
    "sizes",
    type=click.IntRange(2, 10_000),
    multiple=True,
    metavar="N",
    show_default="10 and 40",
    help="Number of clients. Repeat for several rigs.",
)
@click.option("--minutes", type=FiniteRange(2.0, 1440.0), show_default="5", help="Simulated time.")
@click.option(
    "--full",
    is_flag=True,
    help="Simulate 10, 100, 1,000 and 5,000 clients for an hour (takes half an hour on 2 cores).",
)
@click.option(
    "--shape",
    type=click.Choice(["both", "one-leader", "tree"]),
    default="both",
    help="One leader for all clients, a tree of relays, or both in turn.",
)
@click.option(
    "--jobs",
    type=click.IntRange(1, 256),
    metavar="N",
    show_default="one per core",
    help="Number of processes.",
)
@experiment_options
def scale(
    sizes: tuple[int, ...], minutes: float | None, full: bool, shape: str, jobs: int | None, **shared: Any
) -> None:
    """Simulate many clocks for a long time: one leader for all of them, and a tree of relays."""
    from capture_app.experiments.scale import experiment as study

    options = study.ScaleOptions(
        sizes=sizes or (study.FULL_SIZES if full else study.SIZES),
        minutes=minutes or (study.FULL_MINUTES if full else study.MINUTES),
        jobs=jobs,
        shapes=study.SHAPES if shape == "both" else (shape.replace("-", "_"),),
    )
    run_experiment(partial(study.run, options=options), **shared)


@click.command(
    name="link",
    epilog=examples(
        "capture-app experiment link --serve", "capture-app experiment link --connect 192.168.1.20 --trials 3"
    ),
)
@click.option("--serve", is_flag=True, help="Run the leader's end, until Ctrl-C.")
@click.option(
    "--host",
    default="0.0.0.0",  # noqa: S104
    help="With --serve: address to listen on.",
)
@click.option("--port", type=click.IntRange(1, 65535), default=DEFAULT_PORT, help="With --serve: UDP port.")
@click.option("--connect", type=AddressType(), metavar="HOST:PORT", help="Run the client's end, and measure.")
@click.option(
    "--messages",
    type=click.IntRange(300, 1_000_000),
    default=300,
    help="Messages in each trial; from 300 on the engine's clock counts as synchronized.",
)
@click.option(
    "--interval-ms",
    type=FiniteRange(0.2, 10_000.0),
    metavar="MS",
    show_default="the engine's own schedule: 3, 6, 12, then 25 ms",
    help="Time between messages.",
)
@click.option(
    "--true-offset-ns",
    type=int,
    default=0,
    help="True difference of the clocks, leader minus this host; 0 on one machine.",
)
@click.option("--clock", default="host", help="Clock of this end, as for `capture-app node`.")
@click.option("--emulated", is_flag=True, help="Record in the result that the link is emulated.")
@experiment_options
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
    **shared: Any,
) -> None:
    """Measure the engine's clock on a real link: --serve at one end, --connect at the other.

    The client's end joins as a node without a camera; other filters estimate from the same messages.

    The errors are true ones only where --true-offset-ns is known, as between network namespaces of one
    machine.
    """
    from capture_app.clock import parse_clock
    from capture_app.experiments.link.ends import serve as serve_link
    from capture_app.experiments.link.experiment import LinkOptions, run

    if serve == (connect is not None):
        raise click.UsageError("give either --serve or --connect HOST:PORT")
    if connect is None:
        talk(f"listening on {Address(host, port)}")
        run_until_stopped(serve_link(host, port))
        return
    options = LinkOptions(
        address=connect,
        messages=messages,
        pace_ns=None if interval_ms is None else round(interval_ms * 1e6),
        true_offset_ns=true_offset_ns,
        clock=parse_clock(clock, node="link"),
        kind="emulated link" if emulated else "real",
    )
    run_experiment(partial(run, options), **shared)


OWN_COMMANDS = {"clock-filters": clock_filters, "link": link, "paper": paper, "scale": scale}
"""Those with options of their own."""


def load_command(name: str) -> click.Command:
    """Return or make the command of an experiment of the table."""
    return OWN_COMMANDS.get(name) or plain_command(name, EXPERIMENTS[name], partial(load, name))


ALL = {"paper": "Every table and figure of the paper on one page, ours beside them.", **EXPERIMENTS}
"""What there is, each with its help."""


@click.group(
    cls=LazyGroup,
    table=ALL,
    load=load_command,
    epilog=examples("capture-app experiment naive", "capture-app experiment phase --trials 100 --json"),
)
def experiment() -> None:
    """Measure synchronization: our figures beside those of baselines and of the paper."""
