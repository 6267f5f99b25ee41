"""The command `capture-app`: each subcommand is imported when it runs, so that scripting stays quick."""

import importlib
import sys
from collections.abc import Sequence

import click

from capture_app import __version__
from capture_app.terminal import run_command_line

COMMANDS = {
    "leader": "Run a leader: nodes join it, bursts are taken and saved here.",
    "node": "Run one camera and join a leader.",
    "relay": "Carry a leader's time, bursts and images to nodes beyond its reach.",
    "status": "Show the nodes of a running leader.",
    "burst": "Take a burst with a running leader.",
    "cameras": "List the cameras of this machine.",
    "sessions": "List, show, verify, import and export sessions.",
    "experiment": "Run the paper's tables and ours: clocks, phase, the whole chain.",
    "demo": "Simulated cameras, one burst, one comparison: the whole path at once.",
}

ROOMS = {"sessions": "sessions.command", "experiment": "experiment.command"}
"""Commands with commands of their own: where in `capture_app.commands` they live."""


class LazyGroup(click.Group):
    """A group whose commands live in `capture_app.commands`, one module each, named as the command."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names in the order of the table above."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import the module of a command."""
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f"capture_app.commands.{ROOMS.get(cmd_name, cmd_name)}")
        command = getattr(module, cmd_name)
        assert isinstance(command, click.Command)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the table without importing anything."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


@click.group(
    cls=LazyGroup,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(__version__, prog_name="capture-app")
@click.pass_context
def app(ctx: click.Context) -> None:
    """Take pictures of the same instant with many ordinary cameras.

    Without a command the terminal UI opens, with a leader that nodes can join.
    """
    if ctx.invoked_subcommand is None:
        from capture_app.commands.screen import open_screen

        open_screen()


def run(arguments: Sequence[str]) -> int:
    """Run one command line and return its exit code; a mistake is one line on stderr."""
    return run_command_line(app, "capture-app", arguments)


def main() -> None:
    """Run the command line of this process."""
    sys.exit(run(sys.argv[1:]))


if __name__ == "__main__":
    main()
