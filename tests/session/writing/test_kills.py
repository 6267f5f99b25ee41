"""Pulled plugs: a writer that is killed at any moment loses nothing that was confirmed."""

import random
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from tests.session.writing.killed_writer import results_of

killed = partial(results_of, "killed_writer")


def judge(runs: list[dict[str, Any]], least: int) -> None:
    assert len(runs) >= least
    assert any(run["ended"] == -9 and run["promised"] for run in runs), "none was killed in the middle"
    for run in runs:
        assert (run["lost"], run["lies"]) == ([], []), run


def test_a_writer_killed_at_some_steps_loses_nothing(tmp_path: Path) -> None:
    judge(killed(tmp_path, "steps", 3, 100, 29), 8)


def test_a_writer_of_batches_killed_at_some_steps_loses_nothing(tmp_path: Path) -> None:
    judge(killed(tmp_path, "batches", 3, 100, 17), 8)


def test_a_writer_of_videos_killed_at_some_steps_loses_nothing(tmp_path: Path) -> None:
    judge(killed(tmp_path, "videos", 2, 100, 9), 8)


def test_a_writer_killed_at_some_moments_loses_nothing(tmp_path: Path) -> None:
    judge([*killed(tmp_path, "moments", 1, 8), *killed(tmp_path, "steps", 101, 1, 1)], 9)


def test_a_repair_killed_at_some_steps_loses_nothing(tmp_path: Path) -> None:
    judge(killed(tmp_path, "repairs", 151, 1, 1, 13), 3)


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_a_writer_killed_at_every_step_loses_nothing(tmp_path: Path) -> None:
    judge(killed(tmp_path, "steps", 1, 10_000, 1), 200)


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_a_writer_of_batches_killed_at_every_step_loses_nothing(tmp_path: Path) -> None:
    judge(killed(tmp_path, "batches", 1, 10_000, 1), 100)


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_a_writer_of_videos_killed_at_every_step_loses_nothing(tmp_path: Path) -> None:
    judge(killed(tmp_path, "videos", 1, 10_000, 1), 50)


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_a_writer_killed_at_200_random_moments_loses_nothing(tmp_path: Path) -> None:
    judge(killed(tmp_path, "moments", random.SystemRandom().randrange(10**6), 200), 200)


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_a_repair_killed_at_every_step_loses_nothing(tmp_path: Path) -> None:
    judge(killed(tmp_path, "repairs", 17, 30, 9, 1), 500)
