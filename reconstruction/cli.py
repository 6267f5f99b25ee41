"""Command line `reconstruct`; heavy modules are imported on first use."""

import os
import sys
from collections.abc import Sequence
from typing import Any

import click

from capture_app import __version__
from capture_app.common import system
from capture_app.common.errors import ExitCode, SimulshotError
from capture_app.common.plugins import load_plugins
from capture_app.console.terminal import run_command_line, talk
from capture_app.console.usage import add_verbosity, examples
from reconstruction.commands.calibrate import board, calibrate
from reconstruction.commands.compare import compare, tolerance
from reconstruction.commands.live import live
from reconstruction.commands.method_command import method_command
from reconstruction.commands.movers import movers
from reconstruction.commands.time import time_command
from reconstruction.common.memory import limited_memory
from reconstruction.common.native_libraries import TRACEBACK, claim_output, unexpected_error
from reconstruction.common.options import COMMANDS
from reconstruction.common.picture_checksums import checked_pictures
from reconstruction.method.interface import methods


class _Application(click.Group):
    """Group of the commands, which keep to a memory budget, and in which no error ends in a traceback."""

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write each command that is not hidden with its whole sentence."""
        with formatter.section("Commands"):
            # The help wraps a sentence and does not cut it.
            formatter.write_dl(
                [
                    (name, self.commands[name].get_short_help_str(200))
                    for name in self.list_commands(ctx)
                    if not self.commands[name].hidden
                ]
            )

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command, and say what the memory budget and damaged images changed.

        An unexpected exception becomes an error that names its origin.
        """
        try:
            with limited_memory() as budget, checked_pictures() as checks:
                done = super().invoke(ctx)
            for note in (*checks.notes, *budget.notes):
                talk(note)
            return done
        except (SimulshotError, click.ClickException, click.exceptions.Exit, click.Abort, OSError):
            raise
        except Exception as error:
            if os.environ.get(TRACEBACK):
                raise
            raise unexpected_error(error) from error


@click.group(
    cls=_Application,
    epilog=examples("reconstruct compare sessions/burst-001 --out compare"),
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100, "show_default": True},
)
@click.version_option(__version__, prog_name="reconstruct")
def app() -> None:
    """Compute depth and panoramas from a session, and measure the effect of synchronization on them."""


# Before the others, which no plugin of another package replaces.
for method in methods().values():
    app.add_command(method_command(method))
for command in load_plugins(COMMANDS, "get_short_help_str").values():
    app.add_command(command)
for command in (board, calibrate, compare, live, movers, time_command, tolerance):
    app.add_command(command)
add_verbosity(app)


def run(arguments: Sequence[str]) -> int:
    """Run one command line and return its exit code; an error is one line on stderr."""
    return run_command_line(app, "reconstruct", arguments)


def main() -> None:
    """Run the `reconstruct` command given by this process's arguments, and exit with its code."""
    system.end_as_interrupt()
    claim_output()
    system.limit_heaps(len(system.usable_cores()))
    code = run(sys.argv[1:])
    if code == ExitCode.INTERRUPTED:
        # Cleanup is finished. A normal exit would wait for threads that still compute.
        sys.stdout.flush()
        os._exit(code)
    sys.exit(code)


if __name__ == "__main__":
    main()
