"""Jobs are run one after the other, told of, cancelled, retried, and known again by the next start."""

import asyncio
import os
from dataclasses import replace
from pathlib import Path

import pytest

from capture_app.errors import BadInputError
from capture_app.session.library.changes import rename_session, results_folder
from capture_app.session.reading.reader import Session
from capture_app.text import ProgressStep
from capture_app.tui.jobs.job import COMPARE, EXPORTS, KINDS, PANEL, VERIFY, Job, JobState
from capture_app.tui.jobs.job_list import INTERRUPTED, JobList
from capture_app.tui.jobs.results import read_result
from tests.waiting import until

SAMPLES = Path(__file__).parents[3] / "sample_sessions"
QUICK = replace(COMPARE, module="tests.tui.jobs.quick_command", command=("compare",), quick="")


@pytest.fixture
def jobs(tmp_path: Path) -> JobList:
    return JobList(tmp_path)


async def test_a_job_from_queue_to_result(jobs: JobList, session: Session, tmp_path: Path) -> None:
    told: list[JobState] = []
    end = jobs.watch(lambda job: told.append(job.state))
    job = jobs.add(QUICK, session.folder, "say '[3/9] stereo [b]cam00[/b]' say '\x1b[2Jhello' priority")
    await jobs.wait()
    assert job.state is JobState.DONE
    assert job.message == "It is [bold]much[/bold] better. So it is."
    assert list(job.log) == ["[3/9] stereo [b]cam00[/b]", "\\x1b[2Jhello", "priority 19"]
    assert job.step == ProgressStep(3, 9, "stereo [b]cam00[/b]")
    assert job.result == tmp_path / "_results" / "small" / "compare" / "metrics.json"
    assert job.result.is_file()
    assert told[0] is JobState.RUNNING or told[0] is JobState.WAITING
    assert told[-1] is JobState.DONE
    end()


async def test_what_goes_wrong_is_said_in_the_programs_own_words(jobs: JobList, session: Session) -> None:
    job = jobs.add(QUICK, session.folder, "say '[1/9] calibration' fail")
    await jobs.wait()
    assert job.state is JobState.FAILED
    assert job.message == "the burst has one instant only"
    assert job.result is None
    assert not job.is_found
    with pytest.raises(BadInputError, match="cannot be read"):
        jobs.add(QUICK, session.folder, "say 'open")
    with pytest.raises(BadInputError, match="set by the job"):
        jobs.add(QUICK, session.folder, "--out=/elsewhere")
    again = jobs.retry(job)
    await jobs.wait()
    assert again.state is JobState.FAILED
    assert jobs.jobs == [again]


async def test_a_flood_of_lines_is_told_now_and_then(jobs: JobList, session: Session) -> None:
    told: list[JobState] = []
    jobs.watch(lambda job: told.append(job.state))
    job = jobs.add(QUICK, session.folder, "flood 5000")
    await jobs.wait()
    assert job.state is JobState.DONE
    assert job.log[-1] == "line 4999"
    assert len(told) < 200


async def test_one_at_a_time_and_none_twice(jobs: JobList, session: Session, tmp_path: Path) -> None:
    go = tmp_path / "go"
    first = jobs.add(QUICK, session.folder, f"say '[2/5] depth' wait {go}")
    other = jobs.add(replace(QUICK, name="stitch"), session.folder, "")
    with pytest.raises(BadInputError, match="already"):
        jobs.add(QUICK, session.folder)
    await until(lambda: first.step is not None)
    assert (first.state, other.state) == (JobState.RUNNING, JobState.WAITING)
    assert jobs.unfinished == (other, first)
    assert first.share == 0.2
    go.touch()
    await jobs.wait()
    assert (first.state, other.state) == (JobState.DONE, JobState.DONE)


async def test_a_cancelled_job_leaves_nothing_behind(jobs: JobList, session: Session, tmp_path: Path) -> None:
    running = jobs.add(QUICK, session.folder, f"say begun wait {tmp_path / 'never'}")
    waiting = jobs.add(replace(QUICK, name="dose"), session.folder, "")
    await until(lambda: bool(running.log))
    await jobs.cancel(waiting)
    await jobs.cancel(running)
    await jobs.wait()
    assert (running.state, waiting.state) == (JobState.CANCELLED, JobState.CANCELLED)
    place = results_folder(session.folder)
    assert sorted(path.name for path in place.iterdir()) == ["compare.json", "compare.log"]


async def test_a_burst_has_the_machine_to_itself(jobs: JobList, session: Session, tmp_path: Path) -> None:
    go = tmp_path / "go"
    running = jobs.add(QUICK, session.folder, f"say begun wait {go} say after")
    waiting = jobs.add(replace(QUICK, name="dose"), session.folder, "")
    await until(lambda: bool(running.log))
    jobs.hold(True)
    assert (running.state, waiting.state) == (JobState.PAUSED, JobState.WAITING)
    go.touch()
    await asyncio.sleep(0.1)
    assert list(running.log) == ["begun"]
    late = jobs.add(replace(QUICK, name="stitch"), session.folder, "")
    jobs.hold(False)
    await jobs.wait()
    assert list(running.log) == ["begun", "after"]
    assert {job.state for job in (running, waiting, late)} == {JobState.DONE}


async def test_a_paused_job_can_be_cancelled(jobs: JobList, session: Session, tmp_path: Path) -> None:
    job = jobs.add(QUICK, session.folder, f"say begun wait {tmp_path / 'never'}")
    await until(lambda: bool(job.log))
    jobs.hold(True)
    await jobs.close()
    assert job.state is JobState.CANCELLED


async def test_the_next_start_knows_what_was_done(jobs: JobList, session: Session, tmp_path: Path) -> None:
    done = jobs.add(QUICK, session.folder, "say '[1/2] one'")
    await jobs.wait()
    failed = jobs.add(replace(QUICK, name="dose"), session.folder, "fail")
    await jobs.wait()
    unfinished = results_folder(session.folder) / "stitch.json"
    unfinished.write_text('{"kind": "stitch", "session": "small", "state": "running"}')
    (unfinished.parent / "other.json").write_text("{}")
    rename_session(session.folder, "new")
    after = JobList(tmp_path)
    await after.find_earlier()
    found = {job.kind.name: job for job in after.jobs}
    assert {job.session for job in after.jobs} == {tmp_path / "new"}
    assert found["compare"].state is JobState.DONE
    assert found["compare"].message == done.message
    assert list(found["compare"].log) == ["[1/2] one"]
    assert found["compare"].result == tmp_path / "_results" / "new" / "compare" / "metrics.json"
    assert found["compare"].result.is_file()
    assert (found["dose"].state, found["dose"].message) == (JobState.FAILED, failed.message)
    assert (found["stitch"].state, found["stitch"].message) == (JobState.CANCELLED, INTERRUPTED)
    after.forget(found["dose"])
    await after.wait()
    assert not (results_folder(tmp_path / "new") / "dose.json").exists()


async def test_verify_and_export_are_jobs_too(jobs: JobList, session: Session, tmp_path: Path) -> None:
    verified = jobs.add(VERIFY, session.folder)
    exported = jobs.add(EXPORTS["nerfstudio"], session.folder, "", tmp_path / "for nerfstudio")
    await jobs.wait()
    assert verified.message == "every file and every number is as it was saved"
    assert verified.state is JobState.DONE
    assert exported.state is JobState.FAILED
    assert "calibration" in exported.message
    colmap = jobs.add(EXPORTS["colmap"], session.folder, "", tmp_path / "for colmap")
    await jobs.wait()
    assert colmap.state is JobState.DONE
    assert (tmp_path / "for colmap" / "rig_config.json").is_file()
    assert str(tmp_path / "for colmap") in colmap.message
    image = session.image_file(session.manifest.images[0])
    os.truncate(image, 10)
    again = jobs.retry(verified)
    await jobs.wait()
    assert again.state is JobState.FAILED
    assert "is damaged" in again.message


def test_each_kind_has_a_line_that_one_could_type(session: Session, tmp_path: Path) -> None:
    lines = [kind.command_line(session.folder, tmp_path / "out", kind.quick) for kind in KINDS.values()]
    assert all(
        line.startswith(("reconstruct ", "capture-app sessions ", "capture-app panel read "))
        for line in lines
    )
    assert f"capture-app sessions export {session.folder} --to colmap --out {tmp_path / 'out'}" in lines


def test_time_left_is_reckoned_from_the_steps(tmp_path: Path) -> None:
    job = Job(COMPARE, tmp_path, None, "", 1, state=JobState.RUNNING, seconds=30.0)
    assert job.seconds_left is None
    job.step = ProgressStep(3, 9, "stereo")
    assert job.share == pytest.approx(2 / 9)
    assert job.seconds_left is None, "the first steps are short and tell nothing of the others"
    job.step = ProgressStep(4, 9, "stereo")
    assert job.seconds_left == pytest.approx(60.0)
    job.step = ProgressStep(5, 0, "odd")
    assert job.share is None


async def test_a_panel_is_read_and_its_figures_can_be_looked_at(jobs: JobList) -> None:
    job = jobs.add(PANEL, SAMPLES / "led_panel")
    await jobs.wait()
    assert job.state is JobState.DONE, list(job.log)
    assert "apart on average" in job.message
    result = read_result(job)
    assert result.verdict == job.message
    apart, seen = result.tables
    assert [row[0] for row in apart.rows] == ["cam00 – cam01"]
    assert [row[:3] for row in seen.rows] == [("cam00", "5", "0"), ("cam01", "5", "0")]
    assert "shows the same again after 1.0 s" in result.remarks[0]
