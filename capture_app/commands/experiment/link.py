"""`capture-app experiment link`: both ends of a measured link."""

from pathlib import Path

import click

from capture_app.commands.experiment.command import experiment_options, print_outcome
from capture_app.commands.options import AddressType, run_until_stopped
from capture_app.net.address import DEFAULT_PORT, Address
from capture_app.terminal import FiniteRange, talk


@click.command(name="link")
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
def experiment(
    serve: bool,
    host: str,
    port: int,
    connect: Address | None,
    messages: int,
    interval_ms: float | None,
    true_offset_ns: int,
    clock: str,
    emulated: bool,
    trials: int | None,
    seed: int,
    plot: Path | None,
    as_json: bool,
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
    print_outcome(run(options, trials=trials, seed=seed, talk=talk), as_json=as_json, plot=plot)
