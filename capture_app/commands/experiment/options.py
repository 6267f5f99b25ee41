"""Options that several experiments share."""

from collections.abc import Callable
from pathlib import Path

import click

from capture_app.commands.options import FOLDER
from capture_app.terminal import json_option


def require_plots(ctx: click.Context, param: click.Parameter, value: Path | None) -> Path | None:
    """Check before a long run that figures can be drawn into this folder."""
    if value is not None:
        from capture_app.experiments.common.plots import require

        require(value)
    return value


seed_option = click.option(
    "--seed",
    type=click.IntRange(0, 2**63 - 1),
    metavar="N",
    default=1,
    help="Seed of the random numbers.",
)


def experiment_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options that every experiment has."""
    trials = click.option(
        "--trials",
        type=click.IntRange(1, 1_000_000),
        metavar="N",
        show_default="depends on the experiment",
        help="Number of trials.",
    )
    plot = click.option(
        "--plot",
        type=FOLDER,
        metavar="DIR",
        callback=require_plots,
        help="Draw figures into this folder (needs matplotlib).",
    )
    return trials(seed_option(plot(json_option(command))))
