"""A group whose commands are imported when they are needed, so that scripting stays quick."""

from collections.abc import Callable, Mapping
from typing import Any

import click

from capture_app.usage import add_verbosity


class LazyGroup(click.Group):
    """A group that knows its commands by name and help, and loads one when it runs or completes."""

    def __init__(
        self, *, table: Mapping[str, str], load: Callable[[str], click.Command], **options: Any
    ) -> None:
        """`table`: name and help in the order shown; `load` imports the command of a name in it."""
        super().__init__(**options)
        # What click suggests for a mistyped name comes from here.
        self.commands = {name: click.Command(name, help=text) for name, text in table.items()}
        self._load = load

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names in the order of the table."""
        return list(self.commands)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command; None where there is none of this name."""
        return add_verbosity(self._load(cmd_name)) if cmd_name in self.commands else None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the table without importing anything."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, command.help or "") for name, command in self.commands.items()])
