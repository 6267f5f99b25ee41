"""A batch that is killed goes on where it was: no unit twice, and the same bytes in the end."""

import os
import random
import re
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

from capture_app.session.reading.reader import Session
from tests.project import ROOT
from tests.unit.reconstruction.methods.batch.fake_units import LOG


def start(out: Path, session: Path, log: Path, *more: str) -> "subprocess.Popen[bytes]":
    command = [
        sys.executable,
        "-m",
        "tests.unit.reconstruction.methods.batch.fake_units",
        str(out),
        str(session),
        *more,
    ]
    environment = {**os.environ, LOG: str(log)}
    with log.with_suffix(".talk").open("w") as talk:
        return subprocess.Popen(
            command, cwd=ROOT, env=environment, stdout=subprocess.DEVNULL, stderr=talk, start_new_session=True
        )


def lines(log: Path) -> list[str]:
    return log.read_text().splitlines() if log.exists() else []


def results(out: Path) -> dict[str, bytes]:
    """Every file of a batch that is a result, by its path."""
    return {
        str(path.relative_to(out)): path.read_bytes()
        for path in out.rglob("*")
        if path.is_file() and "work" not in path.relative_to(out).parts
    }


def finished(out: Path) -> dict[str, tuple[int, int]]:
    """The finished units' folders, and which file on the disk each one's unit.json is."""
    found = [(path, path.stat()) for path in out.glob("units/*/*/unit.json")]
    return {str(path.parent.relative_to(out)): (stat.st_ino, stat.st_mtime_ns) for path, stat in found}


def kill_and_compare(boards: Session, tmp_path: Path, kills: int, seed: int) -> None:
    chance = random.Random(seed)
    whole, out, log = tmp_path / "whole", tmp_path / "out", tmp_path / "log"
    assert start(whole, boards.folder, tmp_path / "other").wait(120) == 0
    for _ in range(kills):
        wanted = len(lines(log)) + chance.randint(1, 4)
        running = start(out, boards.folder, log)
        while running.poll() is None and len(lines(log)) < wanted:
            time.sleep(0.001)
        time.sleep(chance.uniform(0, 0.02))
        before = finished(out)
        running.kill()
        running.wait()
        after = finished(out)
        assert after.items() >= before.items()
    assert start(out, boards.folder, log).wait(120) == 0
    assert finished(out).items() >= after.items()
    assert results(out) == results(whole)
    begun = Counter(line.split()[1] for line in lines(log) if line.startswith("begin"))
    assert len(begun) == len(finished(out)) == 12
    # What was begun again is what was under way at a kill: at most one unit in each of two processes.
    assert sum(begun.values()) - len(begun) <= 2 * kills
    assert not list(out.rglob("*.part"))


def test_an_interrupt_reaches_all_processes_and_says_what_is_saved(boards: Session, tmp_path: Path) -> None:
    out, log = tmp_path / "out", tmp_path / "log"
    running = start(out, boards.folder, log)
    while not finished(out):
        assert running.poll() is None
        time.sleep(0.001)
    # As a terminal's Ctrl-C: to the command and its processes.
    os.killpg(running.pid, signal.SIGINT)
    assert running.wait(60) == 130
    talk = log.with_suffix(".talk").read_text().splitlines()
    assert re.fullmatch(r"stopping: \d+ of 12 results are saved; repeat .*", talk[-1])
    assert [line for line in talk[:-1] if not line.startswith("[")] == []
    assert not list(out.rglob("*.part"))


def test_a_killed_batch_resumes(boards: Session, tmp_path: Path) -> None:
    kill_and_compare(boards, tmp_path, 3, 1)


def test_shards_at_the_same_time_one_killed_give_the_same_bytes(boards: Session, tmp_path: Path) -> None:
    whole, out = tmp_path / "whole", tmp_path / "out"
    assert start(whole, boards.folder, tmp_path / "other").wait(120) == 0
    parts = ("1/3", "2/3", "3/3")
    logs = {part: tmp_path / f"log{part[0]}" for part in parts}
    running = {part: start(out, boards.folder, logs[part], part) for part in parts}
    while len(lines(logs["2/3"])) < 3:
        assert running["2/3"].poll() is None
        time.sleep(0.001)
    running["2/3"].kill()
    running["2/3"].wait()
    assert [running[part].wait(120) for part in ("1/3", "3/3")] == [0, 0]
    assert len(finished(out)) >= 8
    assert not (out / "summary.json").exists()
    assert start(out, boards.folder, logs["2/3"], "2/3").wait(120) == 0
    assert len(finished(out)) == 12
    assert start(out, boards.folder, tmp_path / "log", "summary").wait(120) == 0
    assert results(out) == results(whole)
    for part in ("1/3", "3/3"):
        assert len([line for line in lines(logs[part]) if line.startswith("begin")]) == 4
    assert not list(out.rglob("*.part"))
