"""The command `capture-app`: each subcommand is imported when it runs, so that scripting stays quick."""

import importlib
import sys
from collections.abc import Sequence
from pathlib import Path

import click

from capture_app import __version__
from capture_app.commands.lazy_group import LazyGroup
from capture_app.errors import NotAvailableError
from capture_app.net.address import DEFAULT_PORT
from capture_app.terminal import run_command_line

COMMANDS = {
    "leader": "Run a leader: nodes join it, and it takes and saves bursts.",
    "node": "Run one camera and join a leader.",
    "relay": "Connect nodes that cannot reach the leader themselves.",
    "status": "Show the nodes of a running leader.",
    "burst": "Take a burst with a running leader.",
    "cameras": "List the cameras of this machine.",
    "sessions": "List, show, verify, rename, annotate, trash, repair, import and export sessions.",
    "experiment": "Measure clock and phase synchronization, beside the paper's figures.",
    "demo": "Try everything on this machine: simulated cameras, a burst, a comparison.",
}


def load(name: str) -> click.Command:
    """Import the module of a command."""
    module = importlib.import_module(f"capture_app.commands.{name}")
    command = getattr(module, name)
    assert isinstance(command, click.Command)
    return command


@click.group(
    cls=LazyGroup,
    table=COMMANDS,
    load=load,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100, "show_default": True},
)
@click.version_option(__version__, prog_name="capture-app")
@click.pass_context
def app(ctx: click.Context) -> None:
    """Take pictures of the same instant with many ordinary cameras.

    Without a command, the terminal UI opens and runs a leader that nodes can join.
    """
    if ctx.invoked_subcommand is not None:
        return
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise NotAvailableError(
            "the screen needs a terminal", hint="use `capture-app leader`, or see capture-app --help"
        )
    from capture_app.tui.app import run_app

    run_app(sessions=Path("sessions"), host="0.0.0.0", port=DEFAULT_PORT)  # noqa: S104 - cameras are other machines


def run(arguments: Sequence[str]) -> int:
    """Run one command line and return its exit code; a mistake is one line on stderr."""
    return run_command_line(app, "capture-app", arguments)


def main() -> None:
    """Run the command line of this process."""
    sys.exit(run(sys.argv[1:]))


if __name__ == "__main__":
    main()
