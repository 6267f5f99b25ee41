"""`capture-app experiment clock-filters`, which can also replay a recorded link."""

from pathlib import Path

import click

from capture_app.commands.experiment.command import experiment_options, print_outcome
from capture_app.terminal import talk


@click.command(name="clock-filters")
@experiment_options
@click.option(
    "--trace",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="CSV",
    help="Also replay the delays of this recording (columns t_s, rtt_ms).",
)
def experiment(trials: int | None, seed: int, plot: Path | None, trace: Path | None, as_json: bool) -> None:
    """Simulate clock estimators: the paper's filters and ours under six delay distributions."""
    from capture_app.experiments.clock_filters.experiment import run

    print_outcome(run(trials=trials, seed=seed, talk=talk, trace=trace), as_json=as_json, plot=plot)
