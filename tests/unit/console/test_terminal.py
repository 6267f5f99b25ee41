"""What both command lines print: tables, progress, mistakes."""

import errno
import json
import os
import pty
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import click
import pytest

from capture_app.common.errors import BadInputError, ExitCode
from capture_app.common.text import ProgressStep
from capture_app.console import terminal
from capture_app.console.terminal import (
    MAX_DRAWN,
    FiniteRange,
    Progress,
    json_option,
    print_json,
    print_line,
    run_command_line,
    show_count,
    table,
    talk,
)

NASTY = "[red]cam\x1b[31m\r"
SHOWN = "[red]cam\\x1b[31m\\r"

ON_A_TERMINAL = """
import time, click
from capture_app.console.terminal import Progress, print_line, run_command_line
@click.command()
def work():
    progress = Progress(2)
    progress.step("stereo [bold]cam00")
    time.sleep(0.3)
    progress.step("report")
    print_line("the result")
run_command_line(work, "work", [])
"""


@click.command()
@click.option("--rate", type=FiniteRange(0, 10), default=1.0)
@click.option("--how", default="")
@json_option
def command(rate: float, how: str, as_json: bool) -> None:
    """A command that can go wrong."""
    if how == "bad":
        raise BadInputError("no\nsession", hint="name another")
    if how == "stop":
        raise KeyboardInterrupt
    if how == "locked":
        raise PermissionError(errno.EACCES, "Permission denied", "/rig/session.json")
    if as_json:
        print_json({"rate": rate})
    else:
        print_line(f"rate {rate:g}")


@pytest.mark.parametrize(
    ("arguments", "code", "out", "err"),
    [
        ((), ExitCode.OK, "rate 1\n", ""),
        (
            ("--rate", "11"),
            ExitCode.USAGE,
            "",
            "--rate takes a number from 0 to 10, not 11.0 (see it --help)",
        ),
        (
            ("--rate", "nan"),
            ExitCode.USAGE,
            "",
            "--rate takes a number from 0 to 10, not 'nan' (see it --help)",
        ),
        (("--rat", "1"), ExitCode.USAGE, "", "Did you mean '--rate'?"),
        (("--how", "bad"), ExitCode.BAD_INPUT, "", "it: error: no session (name another)"),
        (("--how", "stop"), ExitCode.INTERRUPTED, "", ""),
        (("--how", "locked"), ExitCode.FAILURE, "", "it: error: /rig/session.json: Permission denied\n"),
    ],
)
def test_a_command_line_ends_with_a_code_and_at_most_a_line(
    arguments: tuple[str, ...], code: ExitCode, out: str, err: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command_line(command, "it", arguments) == code
    printed = capsys.readouterr()
    assert printed.out == out
    assert err in printed.err
    assert printed.err.count("\n") <= 1


def test_json_is_data_on_stdout(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command_line(command, "it", ["--json"]) == ExitCode.OK
    assert json.loads(capsys.readouterr().out) == {"rate": 1.0}


def test_a_table_in_a_file_is_plain_columns(capsys: pytest.CaptureFixture[str]) -> None:
    print_line(table(("name", "drops"), [("cam00", "7"), ("a", "10"), ("gone", "–")]))
    assert capsys.readouterr().out == "name   drops\ncam00      7\na         10\ngone       –\n"
    print_line(table(("name", "what"), [("x" * 300, "y")]))
    assert len(capsys.readouterr().out.splitlines()) == 2, "not broken at any width"


def test_a_long_table_is_lines_on_a_terminal_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    rows = [(f"take{number}", "a\nb") for number in range(MAX_DRAWN)]
    assert "─" in table(("name", "what"), rows)
    lines = table(("name", "what"), [*rows, ("last", "")]).splitlines()
    assert (lines[0], lines[1], len(lines)) == ("name     what", "take0    a\\nb", MAX_DRAWN + 2)


def test_names_are_neither_markup_nor_control(capsys: pytest.CaptureFixture[str]) -> None:
    print_line(table(("name",), [(NASTY,)]))
    print_line(NASTY)
    talk(NASTY)
    printed = capsys.readouterr()
    assert printed.out == f"name\n{SHOWN}\n{SHOWN}\n"
    assert printed.err == f"{SHOWN}\n"


def test_progress_in_a_file_is_a_line_each_step(capsys: pytest.CaptureFixture[str]) -> None:
    progress = Progress(3)
    progress.step("calibration")
    progress.last("report")
    Progress(1, silent=True).step("nothing")
    assert capsys.readouterr().err.splitlines() == [
        "[1/3] calibration",
        "[3/3] report (1 planned step not needed)",
    ]
    show = show_count("images")
    for done in range(1, 1001):
        show(done, 1000)
    assert len(capsys.readouterr().err.splitlines()) == 10


def test_steps_of_several_threads_are_shown_in_their_order(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = list[int]()

    def show(step: ProgressStep) -> None:
        time.sleep(0.005 if step.done % 2 else 0)
        shown.append(step.done)

    monkeypatch.setattr(terminal, "show_progress", show)
    progress = Progress(8)
    with ThreadPoolExecutor(4) as threads:
        list(threads.map(progress.step, "abcdefgh"))
    assert shown == [*range(1, 9)]


def test_progress_on_a_terminal_is_a_bar_that_goes_before_the_result() -> None:
    ours, theirs = pty.openpty()
    work = subprocess.run(
        [sys.executable, "-c", ON_A_TERMINAL],
        env={**os.environ, "TERM": "xterm", "COLUMNS": "100"},
        stdout=subprocess.PIPE,
        stderr=theirs,
        check=True,
    )
    os.close(theirs)
    seen = os.read(ours, 65536).decode()
    os.close(ours)
    assert work.stdout == b"the result\n", "what is data never goes to the terminal's side"
    assert "stereo [bold]cam00" in seen
    assert "[1/2]" not in seen
    assert "━" in seen
