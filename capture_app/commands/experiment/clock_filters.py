"""`capture-app experiment clock-filters`: with a recorded link to replay, where one is named."""

from pathlib import Path

import click

from capture_app.commands.experiment.command import plot_option, seed_option, show, trials_option
from capture_app.terminal import json_option, talk


@click.command(name="clock-filters")
@trials_option
@seed_option
@plot_option
@click.option(
    "--trace",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="CSV",
    help="Replay this recording (columns t_s, rtt_ms) as one more law.",
)
@json_option
def experiment(trials: int | None, seed: int, plot: Path | None, trace: Path | None, as_json: bool) -> None:
    """Clock estimators in virtual time: the paper's filters and ours under six laws of delay."""
    from capture_app.experiments.clock_filters.experiment import run
    from capture_app.experiments.common.plots import require

    if plot is not None:
        require(plot)
    show(run(trials=trials, seed=seed, talk=talk, trace=trace), as_json=as_json, plot=plot)
