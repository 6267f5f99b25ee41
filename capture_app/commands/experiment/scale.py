"""`capture-app experiment scale`, with the number of clients and the simulated time."""

from pathlib import Path

import click

from capture_app.commands.experiment.command import experiment_options, print_outcome
from capture_app.terminal import FiniteRange, talk


@click.command(name="scale")
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
    """Simulate many clocks for a long time: one leader for all of them, and a tree of relays."""
    from capture_app.experiments.scale.experiment import (
        FULL_MINUTES,
        FULL_SIZES,
        MINUTES,
        SHAPES,
        SIZES,
        ScaleOptions,
        run,
    )

    options = ScaleOptions(
        sizes=sizes or (FULL_SIZES if full else SIZES),
        minutes=minutes or (FULL_MINUTES if full else MINUTES),
        jobs=jobs,
        shapes=SHAPES if shape == "both" else (shape.replace("-", "_"),),
    )
    print_outcome(run(trials=trials, seed=seed, talk=talk, options=options), as_json=as_json, plot=plot)
