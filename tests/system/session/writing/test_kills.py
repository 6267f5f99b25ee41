"""Pulled plugs: a writer that is killed at any moment loses nothing that was confirmed."""

from pathlib import Path

from tests.unit.session.writing.test_kills import judge, killed


def test_a_writer_killed_at_some_steps_loses_nothing(tmp_path: Path) -> None:
    judge(killed(tmp_path, "steps", 3, 100, 29), 8)


def test_a_writer_of_batches_killed_at_some_steps_loses_nothing(tmp_path: Path) -> None:
    judge(killed(tmp_path, "batches", 3, 100, 17), 8)


def test_a_writer_killed_at_some_moments_loses_nothing(tmp_path: Path) -> None:
    judge([*killed(tmp_path, "moments", 1, 8), *killed(tmp_path, "steps", 101, 1, 1)], 9)
