"""What every command has: an example that works, and how much it says."""

import os
import re
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import click
import pytest

from capture_app.cameras import specs
from capture_app.cli import run
from capture_app.common.errors import ExitCode
from capture_app.console.terminal import log_line, run_command_line, show_count, talk
from capture_app.console.usage import Verbosity, add_verbosity, examples, set_verbosity
from capture_app.session.exporting import exporter
from capture_app.session.importing import importer
from reconstruction.cli import run as run_reconstruct
from tests.command_lines import every_command, parse

COMMANDS = {typed: command for typed, command in every_command() if not command.hidden}
"""Without earlier names, whose examples show the name of today."""


def examples_of(command: click.Command) -> list[str]:
    return [line.strip() for line in (command.epilog or "").partition("Examples:\n")[2].splitlines()]


# An earlier name of a command shows the examples of the name it has now.
@pytest.mark.parametrize("typed", [typed for typed, command in COMMANDS.items() if not command.hidden])
def test_the_help_of_every_command_has_an_example_that_the_command_takes(typed: str) -> None:
    shown = examples_of(COMMANDS[typed])
    assert shown, f"{typed} --help has no example: @click.command(epilog=examples(...))"
    for line in shown:
        assert line.startswith(typed)
        parse(line)


def test_examples_are_shown_as_they_are_typed(capsys: pytest.CaptureFixture[str]) -> None:
    line = "it " + "--with-a-long-option=1" * 5

    @click.command(epilog=examples(line, after="Some words."))
    def command() -> None:
        """Do it."""

    run_command_line(command, "it", ["--help"])
    assert capsys.readouterr().out.endswith(f"\n  Some words.\n\n  Examples:\n    {line}\n")


@pytest.mark.parametrize("typed", ["sessions export", "sessions import", "cameras"])
def test_help_where_no_plugin_loads(
    typed: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(exporter, "load_plugins", lambda *_: {})
    monkeypatch.setattr(importer, "load_importers", tuple)
    monkeypatch.setattr(specs, "load_plugins", lambda *_: {})
    assert run([*typed.split(), "--help"]) == ExitCode.OK
    assert "none loads: reinstall simulshot" in capsys.readouterr().out


@click.command()
def work() -> None:
    """Talk, and print a result."""
    talk("working")
    show_count("things")(50, 50)
    click.echo("the result")
    raise OSError("and then\x1b it broke")


@pytest.mark.parametrize("option", ["-q", "--quiet"])
def test_quiet_leaves_results_and_errors(option: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command_line(add_verbosity(work), "work", [option]) == ExitCode.FAILURE
    printed = capsys.readouterr()
    assert printed.out == "the result\n"
    assert printed.err == "work: error: and then\\x1b it broke\n"
    run_command_line(work, "work", [])
    assert capsys.readouterr().err.startswith("working\n[50/50] things\n"), "it lasts for one command"


def test_verbose_adds_times_and_where_an_error_comes_from(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command_line(add_verbosity(work), "work", ["-v"]) == ExitCode.FAILURE
    said = capsys.readouterr().err
    assert re.search(r"^\d\d:\d\d:\d\d\.\d{3} working$", said, re.MULTILINE)
    assert 'raise OSError("and then' in said
    assert "\x1b" not in said
    assert said.endswith("work: error: and then\\x1b it broke\n")
    assert run_command_line(work, "work", ["-v", "-q"]) == ExitCode.USAGE
    assert "exclude each other" in capsys.readouterr().err


@pytest.mark.parametrize("typed", COMMANDS)
def test_every_command_has_them(typed: str) -> None:
    assert {"--quiet", "--verbose"} <= {name for param in COMMANDS[typed].params for name in param.opts}


def test_they_go_before_a_command_too(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert run(["-q", "sessions", "list", str(tmp_path)]) == ExitCode.OK
    assert capsys.readouterr().err == ""
    assert run(["sessions", "list", str(tmp_path)]) == ExitCode.OK
    assert "no sessions" in capsys.readouterr().err


def test_what_a_program_logs_is_seen_with_verbose_only() -> None:
    program = (
        "import sys\nfrom capture_app.cli import run\n"
        "for options in ((), ('-v',)):\n"
        "    assert run((*options, 'sessions', 'schema')) == 0\n"
        "    print('END', file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    quiet, verbose, _ = done.stderr.split("END\n")
    assert quiet == ""
    assert "Python 3" in verbose


def test_a_rigs_log_has_times_in_a_file(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    set_verbosity(Verbosity.NORMAL)
    with capfd.disabled(), (tmp_path / "log").open("w") as file:
        kept = os.dup(2)
        os.dup2(file.fileno(), 2)
        try:
            log_line("cam0: joined")
        finally:
            os.dup2(kept, 2)
            os.close(kept)
    assert re.fullmatch(r"20\d\d-\d\d-\d\d \d\d:\d\d:\d\d cam0: joined\n", (tmp_path / "log").read_text())


@pytest.mark.parametrize("program", [run, run_reconstruct])
def test_no_commands_sentence_is_cut(
    program: Callable[[Sequence[str]], int], capsys: pytest.CaptureFixture[str]
) -> None:
    assert program(["--help"]) == 0
    assert "..." not in capsys.readouterr().out.partition("Commands:")[2]
