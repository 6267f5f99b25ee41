"""A process whose output nobody reads goes on, and says what it left out when somebody reads again."""

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import pytest

from capture_app.console.output import MAX_BYTES, PatientOutput
from tests.project import ROOT

TIMEOUT_S = 180.0
TALKER = """
import asyncio, logging, sys, click
from capture_app.commands.shared_options import run_until_stopped
from capture_app.console.terminal import log_line, print_json_line, run_command_line
from capture_app.console.usage import add_verbosity

async def talk(path, lines):
    for number in range(lines):
        print_json_line({"event": "said", "number": number, "text": "x" * 100})
        log_line(f"line {number} " + "x" * 100)
        logging.getLogger("capture_app").info("logged %d", number)
    open(path, "w").close()
    await asyncio.sleep(600 if lines > 100 else 0)

@click.command()
@click.argument("path")
@click.argument("lines", type=int)
def main(path, lines):
    run_until_stopped(talk(path, lines))
sys.exit(run_command_line(add_verbosity(main), "main", sys.argv[1:]))
"""


@pytest.fixture
def pipe() -> Iterator[tuple[int, int]]:
    reading, writing = os.pipe()
    yield reading, writing
    os.close(reading)
    os.close(writing)


def started(
    tmp_path: Path, *arguments: str, by: tuple[str, ...] = (), stderr: int | IO[bytes] = subprocess.PIPE
) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [*by, sys.executable, "-c", TALKER, str(tmp_path / "done"), *arguments],
        stdout=subprocess.PIPE, stderr=stderr,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip


def until_there(path: Path) -> None:
    ends_s = time.monotonic() + TIMEOUT_S
    while not path.exists():
        assert time.monotonic() < ends_s, f"waited for {path}"
        time.sleep(0.02)


def test_what_is_read_comes_whole_and_in_its_order(tmp_path: Path) -> None:
    process = started(tmp_path, "90")
    out, err = process.communicate(timeout=TIMEOUT_S)
    assert [json.loads(line)["number"] for line in out.splitlines()] == list(range(90))
    assert err.count(b"line ") == 90
    assert process.returncode == 0
    assert (tmp_path / "done").stat().st_mode & 0o777 == 0o640, "for its owner and group"


def test_what_was_left_out_is_said_when_reading_goes_on(tmp_path: Path) -> None:
    process = started(tmp_path, "20000")
    until_there(tmp_path / "done")
    assert process.stdout is not None
    assert process.stderr is not None
    numbers, left_out = [], 0
    for line in process.stdout:
        told = json.loads(line)
        if told["event"] == "left-out":
            left_out += told["lines"]
        else:
            numbers.append(told["number"])
        if len(numbers) + left_out >= 20000:
            break
    # More than one gap is told where the pipe itself took lines between.
    assert numbers == sorted(set(numbers))
    assert left_out > 0
    assert len(numbers) + left_out == 20000
    told_lines = 0
    for text in process.stderr:
        gap = re.fullmatch(rb"\((\d+) lines were left out here: they were not read in time\)\n", text)
        told_lines += int(gap[1]) if gap else 1
        if told_lines >= 20000:
            break
    assert told_lines == 20000
    assert gap, "the last thing told is what was left out"
    process.kill()
    process.communicate()


def test_writes_after_a_gap_follow_its_notice(pipe: tuple[int, int]) -> None:
    reading, writing = pipe
    output = PatientOutput(writing, max_bytes=1 << 14)
    line = b"y" * 999 + b"\n"
    for _ in range(200):
        output.write(line)
    read = b""
    while b"left out" not in read:
        read += os.read(reading, 1 << 16)
    output.write(b"and on\n")
    output.finish(TIMEOUT_S)
    read += os.read(reading, 1 << 16)
    *before, notice, last = read.splitlines()
    assert (last, before) == (b"and on", [line[:-1]] * len(before))
    assert notice == b"(%d lines were left out here: they were not read in time)" % (200 - len(before))


def test_a_line_that_is_larger_than_the_queue_is_written(pipe: tuple[int, int]) -> None:
    reading, writing = pipe
    output = PatientOutput(writing, max_bytes=10)
    output.write(b"z" * (MAX_BYTES // 8))
    assert len(os.read(reading, MAX_BYTES)) > 10


def test_a_reader_that_has_left_is_told_as_an_error(pipe: tuple[int, int]) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    output = PatientOutput(writing)
    output.write(b"to nobody\n")
    output.finish(TIMEOUT_S)
    with pytest.raises(BrokenPipeError):
        output.write(b"more\n")
    os.close(writing)


def test_messages_that_nobody_can_read_any_more_end_nothing(tmp_path: Path) -> None:
    process = started(tmp_path, "90")
    assert process.stdout is not None
    assert process.stderr is not None
    process.stderr.close()
    with process.stdout:
        numbers = [json.loads(line)["number"] for line in process.stdout]
    assert (process.wait(TIMEOUT_S), numbers) == (0, list(range(90)))


def test_messages_for_a_full_disk_end_nothing(tmp_path: Path) -> None:
    with Path("/dev/full").open("wb") as full:
        printed, _ = started(tmp_path, "90", stderr=full).communicate(timeout=TIMEOUT_S)
    assert (tmp_path / "done").exists()
    assert len(printed.splitlines()) == 90


def test_a_gap_in_lines_of_json_is_told_as_json_also_where_it_ends_with_a_line_s_end(
    pipe: tuple[int, int],
) -> None:
    reading, writing = pipe
    output = PatientOutput(writing, max_bytes=1 << 14)
    for _ in range(200):
        output.write(b'{"number":"' + b"1" * 999 + b'"}')
        output.write(b"\n")
    read = b""
    while output._waiting:
        read += os.read(reading, 1 << 16)
    output.write(b'{"number":"2"}\n')
    while b'"2"' not in read:
        read += os.read(reading, 1 << 16)
    assert b'{"event":"left-out","lines":' in read
