"""Pulled plugs: a writer that is killed at any moment loses nothing that was confirmed."""

import json
import os
import random
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[3]


def killed(root: Path, mode: str, *numbers: int) -> list[dict[str, Any]]:
    script = Path(__file__).with_name("killed_writer.py")
    command = [sys.executable, str(script), str(root), mode, *map(str, numbers)]
    done = subprocess.run(
        command, capture_output=True, text=True, check=True, env={**os.environ, "PYTHONPATH": str(ROOT)}
    )
    return [json.loads(line) for line in done.stdout.splitlines()]


def judge(runs: list[dict[str, Any]], least: int) -> None:
    assert len(runs) >= least
    assert any(run["ended"] == -9 and run["promised"] for run in runs), "none was killed in the middle"
    for run in runs:
        assert (run["lost"], run["lies"]) == ([], []), run


def test_a_writer_killed_at_some_steps_loses_nothing(tmp_path: Path) -> None:
    judge(killed(tmp_path, "steps", 3, 100, 29), 8)


def test_a_writer_killed_at_some_moments_loses_nothing(tmp_path: Path) -> None:
    judge([*killed(tmp_path, "moments", 1, 8), *killed(tmp_path, "steps", 101, 1, 1)], 9)


def test_a_repair_killed_at_some_steps_loses_nothing(tmp_path: Path) -> None:
    judge(killed(tmp_path, "repairs", 151, 1, 1, 13), 3)


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_a_writer_killed_at_every_step_loses_nothing(tmp_path: Path) -> None:
    judge(killed(tmp_path, "steps", 1, 10_000, 1), 200)


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_a_writer_killed_at_200_random_moments_loses_nothing(tmp_path: Path) -> None:
    judge(killed(tmp_path, "moments", random.SystemRandom().randrange(10**6), 200), 200)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_a_repair_killed_at_every_step_loses_nothing(tmp_path: Path) -> None:
    judge(killed(tmp_path, "repairs", 17, 30, 9, 1), 500)
