"""Jobs are run one after the other, told of, cancelled, retried, and known again by the next start."""

import os
from pathlib import Path

from capture_app.session.reading.reader import Session
from capture_app.tui.jobs.result_screen import read_result
from capture_app.tui.jobs.run import COMMANDS, EXPORTS, VERIFY, RunState
from capture_app.tui.jobs.runs import Runs
from tests.project import SAMPLES
from tests.unit.tui.jobs.test_runs import (
    runs,  # noqa: F401 - a fixture
)


async def test_verify_and_export_are_jobs_too(runs: Runs, session: Session, tmp_path: Path) -> None:
    verified = runs.add(VERIFY, session.folder)
    exported = runs.add(EXPORTS["nerfstudio"], session.folder, "", tmp_path / "for nerfstudio")
    await runs.wait()
    assert verified.message.endswith(f"all {len(session.manifest.images)} images are intact")
    assert verified.state is RunState.DONE
    assert exported.state is RunState.FAILED
    assert "calibration" in exported.message
    colmap = runs.add(EXPORTS["colmap"], session.folder, "", tmp_path / "for colmap")
    await runs.wait()
    assert colmap.state is RunState.DONE
    assert (tmp_path / "for colmap" / "rig_config.json").is_file()
    assert str(tmp_path / "for colmap") in colmap.message
    image = session.image_file(session.manifest.images[0])
    os.truncate(image, 10)
    again = runs.add(verified.command, verified.session)
    await runs.wait()
    assert again.state is RunState.FAILED
    assert "is damaged" in again.message


async def test_a_panel_is_read_and_its_figures_can_be_looked_at(runs: Runs) -> None:
    job = runs.add(COMMANDS["panel"], SAMPLES / "led_panel")
    await runs.wait()
    assert job.state is RunState.DONE, list(runs.log(job))
    assert "apart on average" in job.message
    result = read_result(job)
    assert result.verdict == job.message
    apart, seen = result.tables
    assert [row[0] for row in apart.rows] == ["cam00 - cam01", "", ""]
    assert [row[:3] for row in seen.rows] == [("cam00", "5", "0"), ("cam01", "5", "0")]
    assert "the pattern repeats after 1.0 s" in result.notes[0]
