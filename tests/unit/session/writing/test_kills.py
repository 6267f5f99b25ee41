"""Pulled plugs: a writer that is killed at any moment loses nothing that was confirmed."""

from functools import partial
from pathlib import Path
from typing import Any

from tests.unit.session.writing.killed_writer import results_of

killed = partial(results_of, "killed_writer")


def judge(runs: list[dict[str, Any]], least: int) -> None:
    assert len(runs) >= least
    assert any(run["ended"] == -9 and run["promised"] for run in runs), "none was killed in the middle"
    for run in runs:
        assert (run["lost"], run["lies"]) == ([], []), run


def test_a_writer_of_videos_killed_at_some_steps_loses_nothing(tmp_path: Path) -> None:
    judge(killed(tmp_path, "videos", 2, 100, 9), 8)


def test_a_repair_killed_at_some_steps_loses_nothing(tmp_path: Path) -> None:
    judge(killed(tmp_path, "repairs", 151, 1, 1, 13), 3)
