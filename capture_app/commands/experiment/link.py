"""`capture-app experiment link`: both ends of a measured link."""

from pathlib import Path

import click

from capture_app.commands.experiment.command import plot_option, seed_option, show, trials_option
from capture_app.commands.options import AddressType, run_until_stopped
from capture_app.net.address import DEFAULT_PORT, Address
from capture_app.terminal import json_option, talk


@click.command(name="link")
@click.option("--serve", is_flag=True, help="Be the leader's end, until stopped.")
@click.option(
    "--host",
    default="0.0.0.0",  # noqa: S104
    show_default=True,
    help="Where --serve listens.",
)
@click.option(
    "--port", type=click.IntRange(1, 65535), default=DEFAULT_PORT, show_default=True, help="Port of --serve."
)
@click.option("--connect", type=AddressType(), metavar="HOST:PORT", help="Be the client's end, and measure.")
@click.option(
    "--messages",
    type=click.IntRange(5, 1_000_000),
    default=300,
    show_default=True,
    help="Messages of each trial.",
)
@click.option(
    "--pace-ms",
    type=click.FloatRange(0.2, 10_000.0),
    default=3.0,
    show_default=True,
    help="A message each so many ms.",
)
@click.option(
    "--true-offset-ns",
    type=int,
    default=0,
    show_default=True,
    help="The leader's clock minus this host's; 0 where both share one kernel.",
)
@click.option(
    "--clock", default="host", show_default=True, help="This end's clock, as of `capture-app node`."
)
@click.option("--emulated", is_flag=True, help="Call the link emulated in the result.")
@trials_option
@seed_option
@plot_option
@json_option
def experiment(
    serve: bool,
    host: str,
    port: int,
    connect: Address | None,
    messages: int,
    pace_ms: float,
    true_offset_ns: int,
    clock: str,
    emulated: bool,
    trials: int | None,
    seed: int,
    plot: Path | None,
    as_json: bool,
) -> None:
    """The clock estimators on a real link: `--serve` on one end, `--connect HOST:PORT` on the other.

    The error is known only where the truth is: between network namespaces of one machine, for example.
    """
    from capture_app.clock import parse_clock
    from capture_app.experiments.common.plots import require
    from capture_app.experiments.link.ends import serve as serve_link
    from capture_app.experiments.link.experiment import LinkOptions, run

    if serve == (connect is not None):
        raise click.UsageError("give either --serve or --connect HOST:PORT")
    if connect is None:
        talk(f"answering on {Address(host, port)}")
        run_until_stopped(serve_link(host, port))
        return
    if plot is not None:
        require(plot)
    options = LinkOptions(
        address=connect,
        messages=messages,
        pace_ns=round(pace_ms * 1e6),
        true_offset_ns=true_offset_ns,
        clock=parse_clock(clock, node="link"),
        kind="emulated link" if emulated else "real",
    )
    show(run(options, trials=trials, seed=seed, talk=talk), as_json=as_json, plot=plot)
