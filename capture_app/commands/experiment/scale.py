"""`capture-app experiment scale`: with its sizes and its length."""

from pathlib import Path

import click

from capture_app.commands.experiment.command import plot_option, seed_option, show, trials_option
from capture_app.terminal import json_option, talk


@click.command(name="scale")
@click.option(
    "--clients",
    "sizes",
    type=click.IntRange(2, 10_000),
    multiple=True,
    help="A number of clients; may be repeated. Default: 10 and 40.",
)
@click.option("--minutes", type=click.FloatRange(2.0, 1440.0), help="Simulated time. Default: 5.")
@click.option(
    "--full", is_flag=True, help="10, 100, 1,000 and 5,000 clients for an hour (half an hour on 2 cores)."
)
@click.option(
    "--shape",
    type=click.Choice(["both", "one-leader", "tree"]),
    default="both",
    show_default=True,
    help="One leader of all, a tree of relays, or one after the other.",
)
@click.option("--jobs", type=click.IntRange(1, 256), help="Processes; default: one for each core.")
@trials_option
@seed_option
@plot_option
@json_option
def experiment(
    sizes: tuple[int, ...],
    minutes: float | None,
    full: bool,
    shape: str,
    jobs: int | None,
    trials: int | None,
    seed: int,
    plot: Path | None,
    as_json: bool,
) -> None:
    """Many clocks for long, in virtual time: one leader of them all beside a tree of relays."""
    from capture_app.experiments.common.plots import require
    from capture_app.experiments.scale.experiment import (
        FULL_MINUTES,
        FULL_SIZES,
        MINUTES,
        SHAPES,
        SIZES,
        ScaleOptions,
        run,
    )

    if plot is not None:
        require(plot)
    options = ScaleOptions(
        sizes=sizes or (FULL_SIZES if full else SIZES),
        minutes=minutes or (FULL_MINUTES if full else MINUTES),
        jobs=jobs,
        shapes=SHAPES if shape == "both" else (shape.replace("-", "_"),),
    )
    show(run(trials=trials, seed=seed, talk=talk, options=options), as_json=as_json, plot=plot)
