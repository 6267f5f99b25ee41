"""`capture-app experiment`: the paper's tables and ours."""

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

import click

from capture_app.experiments import EXPERIMENTS
from capture_app.terminal import json_option, print_json, print_line, print_table, talk

if TYPE_CHECKING:
    from capture_app.experiments.common.result import Outcome

OWN_OPTIONS: dict[str, str] = {
    "clock-filters": "capture_app.commands.experiment.clock_filters",
    "link": "capture_app.commands.experiment.link",
    "scale": "capture_app.commands.experiment.scale",
}
"""Experiments with options of their own: the module whose `experiment` is their command."""

trials_option = click.option("--trials", type=click.IntRange(1, 1_000_000), help="Trials; default: its own.")
seed_option = click.option(
    "--seed", type=click.IntRange(0, 2**63 - 1), default=1, show_default=True, help="Seed of all chance."
)
plot_option = click.option(
    "--plot",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="DIR",
    help="Draw the pictures into this folder (needs simulshot[plots]).",
)


class Experiments(click.Group):
    """A group with a command for each experiment of the table."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names in the order of the table."""
        return list(EXPERIMENTS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Make the command of an experiment."""
        if cmd_name not in EXPERIMENTS:
            return None
        if cmd_name in OWN_OPTIONS:
            own = import_module(OWN_OPTIONS[cmd_name]).experiment
            assert isinstance(own, click.Command)
            return own
        return _command(cmd_name)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the table without importing anything."""
        with formatter.section("Experiments"):
            formatter.write_dl(list(EXPERIMENTS.items()))


@click.group(cls=Experiments)
def experiment() -> None:
    """Run an experiment: figures of ours beside baselines of the same run and the paper's."""


def _command(name: str) -> click.Command:
    @click.command(name=name, help=EXPERIMENTS[name])
    @trials_option
    @seed_option
    @plot_option
    @json_option
    def one(trials: int | None, seed: int, plot: Path | None, as_json: bool) -> None:
        from capture_app.experiments import load
        from capture_app.experiments.common.plots import require

        if plot is not None:
            require(plot)
        show(load(name).run(trials=trials, seed=seed, talk=talk), as_json=as_json, plot=plot)

    return one


def show(outcome: "Outcome", *, as_json: bool, plot: Path | None) -> None:
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
