"""Command lines as people type them: which command they mean, and whether it takes them."""

import shlex
from collections.abc import Iterator

import click

from capture_app.cli import app as capture_app
from reconstruction.cli import app as reconstruct

PROGRAMS: dict[str, click.Group] = {"capture-app": capture_app, "reconstruct": reconstruct}


def every_command() -> Iterator[tuple[str, click.Command]]:
    """What one types for each command, groups too, and the command."""

    def below(typed: str, command: click.Command) -> Iterator[tuple[str, click.Command]]:
        yield typed, command
        if isinstance(command, click.Group):
            context = click.Context(command)
            for name in command.list_commands(context):
                child = command.get_command(context, name)
                assert child is not None
                yield from below(f"{typed} {name}", child)

    for program, group in PROGRAMS.items():
        yield from below(program, group)


def parse(line: str) -> click.Context:
    """Read a command line as its command would, with every option and value; raises click's errors."""
    program, *words = shlex.split(line, comments=True)
    command: click.Command = PROGRAMS[program]
    context = click.Context(command, info_name=program)
    while isinstance(command, click.Group) and words and not words[0].startswith("-"):
        child = command.get_command(context, words[0])
        if child is None:
            raise click.UsageError(f"no command {words[0]!r} in {context.command_path}")
        command, context = child, click.Context(child, info_name=words.pop(0), parent=context)
    return command.make_context(context.info_name, words, parent=context.parent)
