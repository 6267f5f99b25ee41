"""Terminal interface of both commands: results on stdout, messages and progress on stderr, exit codes."""

import contextlib
import io
import math
import os
import stat
import sys
import threading
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from capture_app.common.errors import ExitCode, SimulshotError
from capture_app.common.text import ProgressStep, count, pretty_json, printable, terminal_json
from capture_app.console.known_words import advise
from capture_app.console.output import finish_output
from capture_app.console.usage import Verbosity, set_verbosity, verbosity

if TYPE_CHECKING:
    from rich.progress import Progress as Bar
    from rich.progress import TaskID

_CENTURY_MS = 3e12
json_option = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON on stdout.")


class ParsedType(click.ParamType[Any]):
    """Option type with a parser function, whose BadInputError or ValueError becomes a usage error."""

    def __init__(self, name: str, parse: Callable[[str], Any]) -> None:
        self.name, self._parse = name, parse

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Parse a text; a value that is not a text, such as a default, is returned unchanged."""
        try:
            return self._parse(value) if isinstance(value, str) else value
        except (SimulshotError, ValueError) as error:
            self.fail(str(error), param, ctx)


def _parse_time_shift(text: str) -> tuple[str, float]:
    camera, _, ms = (part.strip() for part in text.rpartition("="))
    with contextlib.suppress(ValueError):
        if camera and abs(float(ms)) < _CENTURY_MS:
            return camera, float(ms)
    raise ValueError(f"{text!r} is not CAMERA=MS, as in cam1=-12.5")


TIME_SHIFT = ParsedType("CAMERA=MS", _parse_time_shift)
"""Type of an option: a camera, in its owner's words, and ms to add to its times."""


class FiniteRange(click.FloatRange):
    """Range of finite numbers: click alone accepts NaN in any range."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Parse a finite number within the range; anything else is a usage error."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a finite number", param, ctx)
        return float(number)


class SessionPath(click.Path):
    """Type of a session's folder, for which the name of one in ./sessions is enough."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path as it was typed, or of the session of that name if nothing is there."""
        path = Path(str(super().convert(value, param, ctx)))
        inside = Path("sessions", path)
        # Unlike Path's, os.path's raise for no name.
        if len(path.parts) == 1 and not os.path.lexists(path) and os.path.isdir(inside):  # noqa: PTH112
            return inside
        return path


SESSION = SessionPath()


def talk(line: str) -> None:
    """Print a message for the user on stderr, except with --quiet.

    One that cannot be written is dropped: a camera goes on though its log's reader is gone or its disk full.
    """
    if verbosity() > Verbosity.QUIET:
        time = f"{datetime.now(UTC).astimezone():%H:%M:%S.%f}"[:-3] + " " if _is_verbose() else ""
        with contextlib.suppress(OSError):
            click.echo(time + printable(line), err=True)


def log_line(line: str) -> None:
    """Print an event of a rig on stderr, with its time unless the reader of a pipe adds it."""
    if not _is_verbose() and (clock := _log_clock()):
        line = f"{datetime.now(UTC).astimezone():{clock}} {line}"
    talk(line)


def _log_clock() -> str:
    """Return the time format of a log line: for a terminal, for a file, or empty."""
    if sys.stderr.isatty():
        return "%H:%M:%S"
    with contextlib.suppress(OSError, ValueError):
        if stat.S_ISREG(os.fstat(sys.stderr.fileno()).st_mode):
            return "%Y-%m-%d %H:%M:%S"
    return ""


def _is_verbose() -> bool:
    return verbosity() == Verbosity.VERBOSE


def print_line(line: str) -> None:
    """Print a line of the result on stdout."""
    _stop_bar()
    click.echo(printable(line))


def print_json(value: Any) -> None:
    """Print one indented JSON object on stdout, for programs and people."""
    _stop_bar()
    click.echo(pretty_json(value))


def print_json_line(value: Any) -> None:
    """Print one JSON object on one line of stdout, at once."""
    click.echo(terminal_json(value))


def answer(as_json: bool, value: Any, lines: Iterable[str] = (), *, said: str = "") -> None:
    """Print a result as one JSON object, or as lines on stdout with the message `said` on stderr.

    Lines of a generator are made only if they are printed.
    """
    if as_json:
        print_json(value)
        return
    for line in lines:
        print_line(line)
    if said:
        talk(said)


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Format a table for stdout, numeric columns right-aligned; without rules for a file, or many rows."""
    rows = [[printable(cell).replace("\n", "\\n") for cell in row] for row in rows]
    numbers = [bool(rows) and all(map(_is_number, column)) for column in zip(*rows, strict=True)]
    numbers = numbers or [False for _ in head]
    if len(rows) > MAX_DRAWN or not sys.stdout.isatty():
        return "\n".join(_aligned([head, *rows], numbers))
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    drawn = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 2, 0, 0))
    for title, is_numeric in zip(head, numbers, strict=True):
        drawn.add_column(Text(title), justify="right" if is_numeric else "left", overflow="fold")
    for row in rows:
        drawn.add_row(*map(Text, row))
    console = Console(file=sys.stdout, color_system=None)
    with console.capture() as printed:
        console.print(drawn)
    return "\n".join(line.rstrip() for line in printed.get().splitlines()).strip("\n")


def _aligned(rows: Sequence[Sequence[str]], numbers: Sequence[bool]) -> Iterator[str]:
    """Yield rows as lines, each column as wide as its widest cell."""
    from rich.cells import cell_len

    widths = [max(map(cell_len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        blanks = [" " * (width - cell_len(cell)) for cell, width in zip(row, widths, strict=True)]
        aligned = (
            blank + cell if is_numeric else cell + blank
            for cell, blank, is_numeric in zip(row, blanks, numbers, strict=True)
        )
        yield "  ".join(aligned).rstrip()


def _is_number(cell: str) -> bool:
    return cell in ("-", "–") or cell.lstrip("+-").replace(".", "", 1).isdecimal()


MAX_DRAWN = 500
"""Maximum number of rows that are drawn as a table: it takes a millisecond each."""
_STEPPING = threading.Lock()


class Progress:
    """Progress of a command on stderr: a bar on a terminal, else a line `[3/9] what` for each step."""

    def __init__(self, total: int, *, silent: bool = False) -> None:
        """Create a progress of `total` steps; a `silent` one only counts, as part of another."""
        self.total = total
        self.done = 0
        self.later = 0
        """Steps that the caller adds to the ones that a part of its work counts."""
        self.silent = silent

    def step(self, text: str) -> None:
        """Show the next step; from any thread."""
        with _STEPPING:
            self.done += 1
            self.total = max(self.total, self.done)
            if not self.silent:
                show_progress(ProgressStep(self.done, self.total, text))

    def last(self, text: str) -> None:
        """Show the last step as the last of all, and how many others were planned but not needed."""
        self.done, unneeded = self.total - 1, self.total - self.done - 1
        self.step(f"{text} ({count(unneeded, 'planned step')} not needed)" if unneeded > 0 else text)


def show_progress(step: ProgressStep) -> None:
    """Show the progress of the running command: on its bar, or as a line if stderr is not a terminal."""
    context = click.get_current_context(silent=True)
    if verbosity() == Verbosity.QUIET:
        return
    global _bar
    if _bar is None:
        # Other threads have no context, and use the bar of the command's own.
        if context is None or _is_verbose() or not sys.stderr.isatty():
            talk(str(step))
            return
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
        from rich.progress import Progress as Bar

        columns = (
            BarColumn(20),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("{task.description}", markup=False),
        )
        # Output to stdout is data, and must not be redirected to stderr, where the bar is.
        bar = Bar(*columns, console=Console(stderr=True), transient=True, redirect_stdout=False)
        _bar = bar, bar.add_task("")
        bar.start()
        context.call_on_close(_stop_bar)
    bar, task = _bar
    bar.update(task, completed=step.done, total=step.total, description=printable(step.text))


def show_count(thing: str) -> Callable[[int, int], None]:
    """Return a function (done, total) that shows a count of things done; outside a terminal, at intervals."""

    def show(done: int, total: int) -> None:
        if sys.stderr.isatty() or done % max(50, total // 10) == 0:
            show_progress(ProgressStep(done, total, thing))

    return show


_bar: "tuple[Bar, TaskID] | None" = None


def _stop_bar() -> None:
    global _bar
    if _bar is not None:
        _bar[0].stop()
        _bar = None


def run_command_line(command: click.Command, name: str, arguments: Sequence[str]) -> int:
    """Run a command line and return its exit code; an error is one line on stderr, without a traceback."""
    set_verbosity(Verbosity.NORMAL)
    # NumPy's matrices are small here: its threads would spin for longer than they compute.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # If a terminal's encoding lacks a character, a replacement is printed; a program reads UTF-8.
            encoding = None if sys.platform != "win32" or stream.isatty() else "utf-8"
            stream.reconfigure(encoding=encoding, errors="replace")
    try:
        return _run(command, name, arguments)
    finally:
        finish_output()


def _run(command: click.Command, name: str, arguments: Sequence[str]) -> int:
    try:
        code = command.main(args=list(arguments), prog_name=name, standalone_mode=False)
    except SimulshotError as error:
        return _fail(name, str(error), error.exit_code, error)
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message(), err=True)
        return ExitCode.USAGE
    except click.UsageError as error:
        where = error.ctx.command_path if error.ctx is not None else name
        return _fail(name, f"{advise(error, arguments)} (see {where} --help)", ExitCode.USAGE)
    except click.ClickException as error:
        return _fail(name, error.format_message(), error.exit_code)
    except (KeyboardInterrupt, click.Abort):
        return ExitCode.INTERRUPTED
    except BrokenPipeError:
        # The reader of stdout has closed it, as `head` does; the interpreter must not report that at exit.
        with open(os.devnull, "wb") as nowhere:  # noqa: PTH123
            os.dup2(nowhere.fileno(), sys.stdout.fileno())
        return ExitCode.FAILURE
    except OSError as error:
        # Without Python's number of the error.
        what = f"{error.filename}: {error.strerror}" if error.filename and error.strerror else str(error)
        return _fail(name, what, ExitCode.FAILURE, error)
    # With standalone_mode off, click returns the code of an early exit, such as --help, or None.
    return code if isinstance(code, int) else ExitCode.OK


def _fail(name: str, message: str, code: int, error: Exception | None = None) -> int:
    if error is not None and _is_verbose():
        click.echo(printable("".join(traceback.format_exception(error))), err=True, nl=False)
    click.echo(f"{name}: error: {printable(' '.join(message.split()))}", err=True)
    return int(code)
