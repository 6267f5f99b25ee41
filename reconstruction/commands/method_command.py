"""The command of a method, derived from its options and its words."""

from pathlib import Path
from typing import Any

import click

from capture_app.console.option_rules import RuledCommand
from capture_app.console.terminal import SESSION, Progress, answer, json_option, talk
from capture_app.console.usage import examples
from reconstruction.commands.command_options import (
    CONDITION,
    CONDITION_HELP,
    click_options,
    out_option,
    time_shift_option,
)
from reconstruction.method.interface import Method
from reconstruction.method.spoken import spoken
from reconstruction.scene.conditions import SYNCED, Condition


def method_command(method: type[Method]) -> click.Command:
    """Return the command that runs a method on a session, or on images if it takes them."""
    sources = ("SESSION|IMAGE...", -1) if method.takes_images else ("SESSION", 1)

    @click.command(
        method.name,
        cls=RuledCommand,
        rules=method.rules,
        help=method.help,
        epilog=examples(*(f"reconstruct {example}" for example in method.examples)),
    )
    @click.option("--condition", type=CONDITION, metavar="CONDITION", default=SYNCED, help=CONDITION_HELP)
    @time_shift_option
    @out_option
    @json_option
    def command(
        sources: tuple[Path, ...] | Path, condition: Condition, out: Path, as_json: bool, **chosen: Any
    ) -> None:
        try:
            run = method(progress=Progress(1), **chosen)
        except ValueError as error:
            raise click.UsageError(str(error)) from error
        result = run.make(sources if isinstance(sources, tuple) else (sources,), out, condition)
        said = spoken(result, result.labels)
        for note in run.notes(said):
            talk(note)
        answer(as_json, result, run.lines(said, out))

    metavar, count = sources
    argument = click.Argument(["sources"], type=SESSION, metavar=metavar, nargs=count, required=True)
    command.params[:0] = [argument, *click_options(method, own=True)]
    return command
