"""Options and help common to all commands: examples in the epilog, and `--quiet` and `--verbose`."""

import logging
import platform
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from enum import IntEnum
from typing import TypeVar

import click

from capture_app import __version__

C = TypeVar("C", bound=click.Command)


class Verbosity(IntEnum):
    """Amount of output of a command on stderr."""

    QUIET = 0
    """Errors only."""
    NORMAL = 1
    VERBOSE = 2
    """With times, log messages, and tracebacks of errors."""


_verbosity = Verbosity.NORMAL
"""Verbosity of this process's command line."""
_silenced = ContextVar("silenced", default=False)
"""Whether the current thread or task, not the process, runs within `silence`."""
_log = logging.getLogger(__name__)


def verbosity() -> Verbosity:
    """Return the verbosity of the running command."""
    return Verbosity.QUIET if _silenced.get() else _verbosity


def set_verbosity(value: Verbosity) -> None:
    """Set the verbosity of the running command."""
    global _verbosity
    _verbosity = value
    if value is Verbosity.VERBOSE:
        logging.basicConfig(
            level=logging.INFO, format="%(asctime)s %(name)s: %(message)s", datefmt="%H:%M:%S"
        )
        logging.getLogger(__name__.partition(".")[0]).setLevel(logging.DEBUG)
        _log.debug("simulshot %s, Python %s, %s", __version__, platform.python_version(), platform.platform())


@contextmanager
def silence() -> Iterator[None]:
    """Suppress progress and notes of the code within the block, but of no other thread."""
    token = _silenced.set(True)
    try:
        yield
    finally:
        _silenced.reset(token)


def examples(*lines: str, after: str = "") -> str:
    """Return the epilog of a command: an optional text, then example command lines."""
    # A line with only \b keeps click from wrapping the paragraph.
    shown = "\n".join(("\b", "Examples:", *(f"  {line}" for line in lines)))
    return f"{after}\n\n{shown}" if after else shown


def write_plugins(formatter: click.HelpFormatter, title: str, rows: Sequence[tuple[str, str]]) -> None:
    """Write the installed plugins of a kind as a section of a help page: the name and text of each."""
    with formatter.section(title):
        if rows:
            formatter.write_dl(rows)
        else:
            formatter.write_text("none loads: reinstall simulshot")


def add_verbosity(command: C) -> C:
    """Add the options -q and -v to a command and to its loaded subcommands."""
    if _OPTIONS[0] not in command.params:
        command.params += _OPTIONS
    # A lazy group has only names, and calls this with each command that it loads.
    if isinstance(command, click.Group):
        for below in command.commands.values():
            add_verbosity(below)
    return command


def _choose(ctx: click.Context, param: click.Parameter, given: bool) -> None:
    value = Verbosity[(param.name or "").upper()]
    if given and verbosity() not in (Verbosity.NORMAL, value):
        raise click.UsageError("--quiet and --verbose exclude each other")
    if given:
        set_verbosity(value)


_OPTIONS = [
    click.Option(names, is_flag=True, expose_value=False, callback=_choose, help=text)
    for names, text in (
        (("-q", "--quiet"), "Print errors and results only."),
        (("-v", "--verbose"), "Print more, with times."),
    )
]
