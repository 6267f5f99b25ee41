"""Pulled plugs: a writer that is killed at any moment loses nothing that was confirmed."""

import random
from pathlib import Path

import pytest

from tests.unit.session.writing.test_kills import judge, killed


@pytest.mark.timeout(1800)
def test_a_writer_killed_at_every_step_loses_nothing(tmp_path: Path) -> None:
    judge(killed(tmp_path, "steps", 1, 10_000, 1), 200)


@pytest.mark.timeout(1800)
def test_a_writer_of_batches_killed_at_every_step_loses_nothing(tmp_path: Path) -> None:
    judge(killed(tmp_path, "batches", 1, 10_000, 1), 100)


@pytest.mark.timeout(1800)
def test_a_writer_of_videos_killed_at_every_step_loses_nothing(tmp_path: Path) -> None:
    judge(killed(tmp_path, "videos", 1, 10_000, 1), 50)


@pytest.mark.timeout(1800)
def test_a_writer_killed_at_200_random_moments_loses_nothing(tmp_path: Path) -> None:
    judge(killed(tmp_path, "moments", random.SystemRandom().randrange(10**6), 200), 200)


@pytest.mark.timeout(3600)
def test_a_repair_killed_at_every_step_loses_nothing(tmp_path: Path) -> None:
    judge(killed(tmp_path, "repairs", 17, 30, 9, 1), 500)
