"""A batch that is killed goes on where it was: no unit twice, and the same bytes in the end."""

import random
import subprocess
import time
from pathlib import Path

import pytest

from capture_app.session.reading.reader import Session
from tests.system.reconstruction.methods.batch.test_kill import finished, kill_and_compare, results, start


@pytest.mark.timeout(1800)
def test_real_units_killed_twenty_times_give_the_same_bytes(boards: Session, tmp_path: Path) -> None:
    chance = random.Random(3)
    whole, out, log = tmp_path / "whole", tmp_path / "out", tmp_path / "log"
    began = time.monotonic()
    assert start(whole, boards.folder, log, "real").wait(900) == 0
    took = time.monotonic() - began
    kills = 0
    kept: dict[str, tuple[int, int]] = {}
    while kills < 20:  # the last units of a batch may be done before their kill: that is none
        running = start(out, boards.folder, log, "real")
        try:
            running.wait(chance.uniform(0.1, 0.7) * took)
        except subprocess.TimeoutExpired:
            running.kill()
            running.wait()
            kills += 1
        now = finished(out)
        assert now.items() >= kept.items()
        kept = now
        if len(now) == 5:
            # All done: begin again, so that it is twenty real kills.
            assert start(out, boards.folder, log, "real").wait(900) == 0
            assert finished(out) == now
            assert results(out) == results(whole)
            out, kept = tmp_path / f"out{kills}", {}
    assert start(out, boards.folder, log, "real").wait(900) == 0
    assert finished(out).items() >= kept.items()
    assert results(out) == results(whole)


def test_a_batch_killed_twenty_times_resumes(boards: Session, tmp_path: Path) -> None:
    for seed in range(7):
        (tmp_path / str(seed)).mkdir()
        kill_and_compare(boards, tmp_path / str(seed), 3, seed)
