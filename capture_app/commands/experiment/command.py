"""`capture-app experiment`: the paper's tables and ours."""

from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

import click

from capture_app.commands.lazy_group import LazyGroup
from capture_app.experiments import EXPERIMENTS, load
from capture_app.terminal import json_option, print_json, print_line, print_table, talk

if TYPE_CHECKING:
    from capture_app.experiments import Experiment
    from capture_app.experiments.common.result import Outcome

OWN_OPTIONS = ("clock-filters", "link", "scale")
"""Experiments with options of their own, each the `experiment` of the module of its name."""


def _require_plots(ctx: click.Context, param: click.Parameter, value: Path | None) -> Path | None:
    """Check before a long run that figures can be drawn."""
    if value is not None:
        from capture_app.experiments.common.plots import require

        require(value)
    return value


def experiment_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options that every experiment has."""
    trials = click.option(
        "--trials",
        type=click.IntRange(1, 1_000_000),
        metavar="N",
        show_default="depends on the experiment",
        help="Number of trials.",
    )
    seed = click.option(
        "--seed",
        type=click.IntRange(0, 2**63 - 1),
        metavar="N",
        default=1,
        help="Seed of the random numbers.",
    )
    plot = click.option(
        "--plot",
        type=click.Path(path_type=Path, file_okay=False),
        metavar="DIR",
        callback=_require_plots,
        help="Draw figures into this folder (needs simulshot[plots]).",
    )
    return trials(seed(plot(json_option(command))))


def load_command(name: str) -> click.Command:
    """Import or make the command of an experiment of the table."""
    if name in OWN_OPTIONS:
        own = import_module(f"capture_app.commands.experiment.{name.replace('-', '_')}").experiment
        assert isinstance(own, click.Command)
        return own
    return plain_command(name, EXPERIMENTS[name], partial(load, name))


def plain_command(name: str, text: str, load_experiment: "Callable[[], Experiment]") -> click.Command:
    """Make the command of an experiment without options of its own; `text` is its help."""

    @click.command(name=name, help=text)
    @experiment_options
    def command(trials: int | None, seed: int, plot: Path | None, as_json: bool) -> None:
        outcome = load_experiment().run(trials=trials, seed=seed, talk=talk)
        print_outcome(outcome, as_json=as_json, plot=plot)

    return command


@click.group(cls=LazyGroup, table=EXPERIMENTS, load=load_command)
def experiment() -> None:
    """Measure synchronization: our figures beside those of baselines and of the paper."""


def print_outcome(outcome: "Outcome", *, as_json: bool, plot: Path | None) -> None:
    """Print an outcome on stdout and draw its pictures."""
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
