"""Command line `capture-app`; each subcommand's module is imported only when it runs, for a fast start.

Entry points of the group `simulshot.commands` are further click commands: companions', and other packages'.
"""

import asyncio
import importlib
import os
import sys
from collections.abc import Sequence
from pathlib import Path

import click
from click.core import ParameterSource

from capture_app import __version__
from capture_app.commands.shared_options import (
    ADDRESS,
    attached_sessions_option,
    cameras_option,
    rig_port_option,
)
from capture_app.common.address import Address
from capture_app.common.errors import NotAvailableError
from capture_app.common.passwords import hide_password
from capture_app.common.plugins import COMMANDS as PLUGIN_COMMANDS
from capture_app.common.plugins import load_plugin, load_plugins, plugin_names
from capture_app.console.option_rules import Rule, RuledCommand
from capture_app.console.terminal import run_command_line, talk
from capture_app.console.usage import add_verbosity, examples

COMMANDS = {
    "rig": "Start, list and stop rigs that run in the background of this machine.",
    "leader": "Run a leader: nodes join it, and it takes and saves bursts.",
    "node": "Run one camera and join a leader.",
    "relay": "Connect nodes that cannot reach the leader themselves.",
    "doctor": "Check this machine for problems, and show remedies.",
    "trust": "List, pair and remove trusted machines.",
    "status": "Show the nodes of a running leader.",
    "burst": "Take a burst with a running leader.",
    "record": "Record a synchronized video with every camera.",
    "cameras": "List the cameras of this machine; add, show and remove a running rig's.",
    "preview": "Save a small live picture of a camera.",
    "coverage": "Show live which views of a calibration board are missing.",
    "serve": "Show the terminal UI in a browser.",
    "sessions": "List, show, verify, rename, annotate, trash, repair, import and export sessions.",
    "demo": "Try everything on this machine: simulated cameras, a burst, a comparison.",
}
MODULES = {"burst": "take", "record": "take"}
"""Modules of `commands` whose name differs from the command's."""


class LazyGroup(RuledCommand, click.Group):
    """Group of the commands, which imports one when it runs or completes."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names in the order of the table, then the names of plugins."""
        return [*COMMANDS, *(name for name in plugin_names(PLUGIN_COMMANDS) if name not in COMMANDS)]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command; return None if the name is unknown."""
        if cmd_name in COMMANDS:
            module = importlib.import_module(f"capture_app.commands.{MODULES.get(cmd_name, cmd_name)}")
            command = getattr(module, cmd_name)
        elif cmd_name in self.list_commands(ctx):
            command = load_plugin(PLUGIN_COMMANDS, cmd_name, "get_short_help_str")
        else:
            return None
        assert isinstance(command, click.Command)
        return add_verbosity(command)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the table, and import plugins' commands only."""
        plugins = load_plugins(PLUGIN_COMMANDS, "get_short_help_str")
        shown = {name: command.get_short_help_str(limit=70) for name, command in plugins.items()} | COMMANDS
        with formatter.section("Commands"):
            formatter.write_dl([(name, shown[name]) for name in self.list_commands(ctx) if name in shown])


@click.group(
    cls=LazyGroup,
    rules=(Rule("--host --port --camera", "!--leader", ": they are of a rig of this machine"),),
    invoke_without_command=True,
    epilog=examples(
        "capture-app",
        "capture-app --leader 192.168.1.20",
        after="A leader synchronizes nodes; each node runs a camera. A burst is a series of instants: common"
        " times at which every camera takes a frame. It is saved as a session: a folder of images and times.",
    ),
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100, "show_default": True},
)
@click.version_option(__version__, prog_name="capture-app")
@click.option(
    "--leader",
    type=ADDRESS,
    metavar="HOST:PORT",
    help="Show the rig of a leader that runs elsewhere.",
)
@attached_sessions_option
@click.option(
    "--host",
    default="0.0.0.0",  # noqa: S104 - cameras are other machines
    help="Address that a new rig listens on; 127.0.0.1 accepts this machine only.",
)
@rig_port_option
@cameras_option
@click.option(
    "--frames",
    type=click.IntRange(1, 1000),
    metavar="N",
    show_default="as last time",
    help="Number of frames from each camera.",
)
@click.option(
    "--depth/--no-depth",
    default=True,
    help="Compute the depth of each take of a calibrated rig, at low priority.",
)
@click.pass_context
def app(
    ctx: click.Context,
    leader: Address | None,
    sessions: Path | None,
    host: str,
    port: int | None,
    cameras: tuple[str, ...],
    frames: int | None,
    depth: bool,
) -> None:
    """Take pictures of the same instant with many ordinary cameras.

    Without a command, the terminal UI opens on the running rig of this machine, or on a new one, which keeps
    running in the background until it is stopped.
    """
    given = [name for name in ctx.params if ctx.get_parameter_source(name) is ParameterSource.COMMANDLINE]
    if ctx.invoked_subcommand is not None:
        if given:
            raise click.UsageError(
                f"--{given[0]} belongs after the command {ctx.invoked_subcommand}, if it has it"
            )
        return
    in_browser = "TEXTUAL_DRIVER" in os.environ
    if not in_browser and not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise NotAvailableError(
            "the screen needs a terminal", hint="use `capture-app leader`, or see capture-app --help"
        )
    talk("Starting the screen, and a rig in the background if none is running …")
    from capture_app.commands.leader_choice import make_known
    from capture_app.rig.process import attach
    from capture_app.tui.app import run_screen

    if leader is not None and not in_browser:
        make_known((leader,), None, None)
    rig = asyncio.run(attach(leader=leader, sessions=sessions, host=host, port=port, cameras=cameras))
    run_screen(rig, frames=frames, depth=depth)


add_verbosity(app)


def run(arguments: Sequence[str]) -> int:
    """Run one command line and return its exit code; an error is one line on stderr."""
    return run_command_line(app, "capture-app", arguments)


def main() -> None:
    """Run this process's command line; first re-execute without its passwords, to hide them from `ps`."""
    shown = [hide_password(argument) for argument in sys.orig_argv]
    if shown != sys.orig_argv and os.name == "posix":  # Windows shows them to this user only
        os.execv(sys.executable, shown)  # noqa: S606 - this program once more
    sys.exit(run(sys.argv[1:]))


if __name__ == "__main__":
    main()
