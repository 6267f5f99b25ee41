"""`capture-app link`: the clock over a real link, or over a recorded one."""

import asyncio
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from capture_app.commands.options import ADDRESS, FOLDER, run_until_stopped
from capture_app.common.address import DEFAULT_PORT, Address
from capture_app.console.terminal import FiniteRange, answer, json_option, table, talk
from capture_app.console.usage import examples

if TYPE_CHECKING:
    from capture_app.measure.result import Outcome


def outcome_lines(outcome: "Outcome") -> Iterator[str]:
    """The tables and notes of what was measured."""
    result = outcome.result
    yield f"{result.name}: {result.kind}, {result.trials} trials, seed {result.seed}"
    for one in outcome.tables:
        yield f"\n{one.title}" if one.title else ""
        yield table(one.head, one.rows)
    for note in outcome.notes:
        yield f"\n{note}"


@click.command(
    epilog=examples(
        "capture-app link --serve",
        "capture-app link --connect 192.168.1.20 --trials 3",
        "capture-app link --replay delays.csv --plot figures",
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
    "--replay",
    "recording",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="CSV",
    help="Replay the delays of a recorded link (columns t_s, rtt_ms) to simulated clocks.",
)
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
    show_default="10, with --replay 100",
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
    recording: Path | None,
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
    machine; with --replay the clocks are simulated, and all errors true.
    """
    from capture_app.common.clock import parse_clock
    from capture_app.measure import link as measuring
    from capture_app.measure.result import require_plots

    if [serve, connect is not None, recording is not None].count(True) != 1:
        raise click.UsageError("give one of --serve, --connect HOST:PORT and --replay CSV")
    if plot is not None:
        require_plots(plot)
    if connect is not None:
        outcome = asyncio.run(
            measuring.measure(
                connect,
                parse_clock(clock, node="link"),
                messages=messages,
                pace_ns=None if interval_ms is None else round(interval_ms * 1e6),
                true_offset_ns=true_offset_ns,
                kind="emulated link" if emulated else "real",
                trials=trials,
                seed=seed,
                talk=talk,
            )
        )
    elif recording is not None:
        outcome = measuring.replay(recording, messages, trials=trials, seed=seed)
    else:
        talk(f"listening on {Address(host, port)}")
        run_until_stopped(measuring.serve(host, port))
        return
    answer(as_json, outcome.result, outcome_lines(outcome))
    if plot is not None:
        for path in outcome.draw(plot):
            talk(f"drew {path}")
