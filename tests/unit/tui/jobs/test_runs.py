"""Jobs are run one after the other, told of, cancelled, retried, and known again by the next start."""

import asyncio
import json
import socket
from dataclasses import replace
from pathlib import Path

import pytest

from capture_app.common.errors import BadInputError
from capture_app.common.text import ProgressStep
from capture_app.session.library.changes import rename_session, results_folder
from capture_app.session.reading.reader import Session
from capture_app.tui.jobs.run import COMMANDS, Run, RunState
from capture_app.tui.jobs.runs import INTERRUPTED, Runs
from reconstruction.methods.people import people_result
from reconstruction.methods.splat import splat_run
from reconstruction.methods.view import view_run
from tests.waiting import until

QUICK, QUICK_STITCH, QUICK_DOSE = (
    replace(
        COMMANDS["compare"],
        name=name,
        module="tests.unit.tui.jobs.quick_command",
        words=("compare",),
        quick="",
    )
    for name in ("compare", "panorama", "tolerance")
)


@pytest.fixture
def runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Runs:
    for quick in (QUICK, QUICK_STITCH, QUICK_DOSE):
        monkeypatch.setitem(COMMANDS, quick.name, quick)
    return Runs(tmp_path)


def test_a_job_opens_the_page_that_its_command_writes() -> None:
    pages = {"view": view_run.PAGE, "splat": splat_run.PAGE, "people": people_result.PAGE}
    assert {name: COMMANDS[name].page for name in pages} == pages


async def test_a_job_from_queue_to_result(runs: Runs, session: Session, tmp_path: Path) -> None:
    told: list[RunState] = []
    runs = Runs(tmp_path, lambda run: told.append(run.state) if run else None)
    job = runs.add(QUICK, session.folder, "say '[3/9] stereo [b]cam00[/b]' say '\x1b[2Jhello' priority")
    await runs.wait()
    assert job.state is RunState.DONE
    assert job.message == "It is [bold]much[/bold] better. So it is."
    assert list(runs.log(job)) == ["[3/9] stereo [b]cam00[/b]", "\\x1b[2Jhello", "priority 19"]
    assert job.result == tmp_path / "_results" / "small" / "compare" / "metrics.json"
    assert job.result.is_file()
    assert told[0] is RunState.RUNNING or told[0] is RunState.WAITING
    assert told[-1] is RunState.DONE


async def test_what_goes_wrong_is_said_in_the_programs_own_words(runs: Runs, session: Session) -> None:
    job = runs.add(QUICK, session.folder, "say '[1/9] calibration' fail")
    await runs.wait()
    assert job.state is RunState.FAILED
    assert job.message == "the burst has one instant only"
    assert job.result is None
    with pytest.raises(BadInputError, match="are not valid"):
        runs.add(QUICK, session.folder, "say 'open")
    with pytest.raises(BadInputError, match="set by the job"):
        runs.add(QUICK, session.folder, "--out=/elsewhere")
    again = runs.add(job.command, job.session, job.options, job.out)
    await runs.wait()
    assert again.state is RunState.FAILED
    assert runs.all == [again]


async def test_a_flood_of_lines_is_not_told_line_by_line(
    runs: Runs, session: Session, tmp_path: Path
) -> None:
    told: list[Run | None] = []
    runs = Runs(tmp_path, told.append)
    job = runs.add(QUICK, session.folder, "flood 5000")
    await runs.wait()
    assert job.state is RunState.DONE
    assert runs.log(job)[-1] == "line 4999"
    assert len(told) == 3, "it waits, runs, is done"


async def test_one_at_a_time_and_none_twice(runs: Runs, session: Session, tmp_path: Path) -> None:
    go = tmp_path / "go"
    first = runs.add(QUICK, session.folder, f"say '[2/5] depth' wait {go}")
    other = runs.add(QUICK_STITCH, session.folder, "")
    with pytest.raises(BadInputError, match="already"):
        runs.add(QUICK, session.folder)
    await until(lambda: first.step is not None)
    assert (first.state, other.state) == (RunState.RUNNING, RunState.WAITING)
    assert runs.unfinished == [other, first]
    assert first.fraction == 0.2
    go.touch()
    await runs.wait()
    assert (first.state, other.state) == (RunState.DONE, RunState.DONE)


async def test_a_cancelled_job_leaves_nothing_behind(runs: Runs, session: Session, tmp_path: Path) -> None:
    running = runs.add(QUICK, session.folder, f"say begun wait {tmp_path / 'never'}")
    waiting = runs.add(QUICK_DOSE, session.folder, "")
    await until(lambda: bool(runs.log(running)))
    await runs.cancel(waiting)
    await runs.cancel(running)
    await runs.wait()
    assert (running.state, waiting.state) == (RunState.CANCELLED, RunState.CANCELLED)
    place = results_folder(session.folder)
    assert sorted(path.name for path in place.iterdir()) == ["compare.json", "compare.log"]


async def test_a_burst_has_the_machine_to_itself(runs: Runs, session: Session, tmp_path: Path) -> None:
    go = tmp_path / "go"
    running = runs.add(QUICK, session.folder, f"say begun wait {go} say after")
    waiting = runs.add(QUICK_DOSE, session.folder, "")
    await until(lambda: bool(runs.log(running)))
    runs.hold(True)
    assert (running.state, waiting.state) == (RunState.PAUSED, RunState.WAITING)
    go.touch()
    await asyncio.sleep(0.1)
    assert list(runs.log(running)) == ["begun"]
    late = runs.add(QUICK_STITCH, session.folder, "")
    runs.hold(False)
    await runs.wait()
    assert list(runs.log(running)) == ["begun", "after"]
    assert {job.state for job in (running, waiting, late)} == {RunState.DONE}


async def test_a_paused_job_can_be_cancelled(runs: Runs, session: Session, tmp_path: Path) -> None:
    job = runs.add(QUICK, session.folder, f"say begun wait {tmp_path / 'never'}")
    await until(lambda: bool(runs.log(job)))
    runs.hold(True)
    await runs.close()
    assert job.state is RunState.CANCELLED


async def test_the_next_start_knows_what_was_done(runs: Runs, session: Session, tmp_path: Path) -> None:
    done = runs.add(QUICK, session.folder, "say '[1/2] one'")
    await runs.wait()
    failed = runs.add(QUICK_DOSE, session.folder, "fail")
    await runs.wait()
    unfinished = results_folder(session.folder) / "panorama.json"
    unfinished.write_text('{"kind": "panorama", "session": "small", "state": "running"}')
    (unfinished.parent / "other.json").write_text("{}")
    rename_session(session.folder, "new")
    after = Runs(tmp_path)
    await after.read()
    found = {job.kind: job for job in after.all}
    assert {job.session for job in after.all} == {tmp_path / "new"}
    assert found["compare"].state is RunState.DONE
    assert found["compare"].message == done.message
    assert list(after.log(found["compare"])) == ["[1/2] one"]
    assert found["compare"].result == tmp_path / "_results" / "new" / "compare" / "metrics.json"
    assert found["compare"].result.is_file()
    assert (found["tolerance"].state, found["tolerance"].message) == (RunState.FAILED, failed.message)
    assert (found["panorama"].state, found["panorama"].message) == (RunState.CANCELLED, INTERRUPTED)
    await after.forget(found["tolerance"])
    assert not (results_folder(tmp_path / "new") / "tolerance.json").exists()


async def test_a_job_of_another_screen_runs_until_that_screen_ends(session: Session, tmp_path: Path) -> None:
    other = await asyncio.create_subprocess_exec("sleep", "600")
    stored = results_folder(session.folder) / "panorama.json"
    stored.parent.mkdir(parents=True, exist_ok=True)
    owner = f"{socket.gethostname()}:{other.pid}"
    text = {"kind": "panorama", "session": session.folder.name, "state": "running", "owner": owner}
    stored.write_text(json.dumps(text))
    ended = text | {"kind": "tolerance", "state": "cancelled", "ended": "2026-01-02T03:04:05Z"}
    stored.with_name("tolerance.json").write_text(json.dumps(ended))
    runs = Runs(tmp_path)
    await runs.read()
    job, _ = runs.all
    assert (job.state, job.is_foreign, runs.unfinished) == (RunState.RUNNING, True, [])
    assert f"another screen on this machine (process {other.pid})" in job.message
    await runs.close()
    assert json.loads(stored.read_text()) == text, "closing this screen leaves it alone"
    with pytest.raises(BadInputError, match="running already"):
        runs.add(COMMANDS["panorama"], session.folder)
    other.kill()
    await other.wait()
    await runs.read()
    assert (RunState.CANCELLED, INTERRUPTED) in [(run.state, run.message) for run in runs.all]


@pytest.mark.parametrize(
    "odd", ['"options": "say \'open"', '"options": "--out=/elsewhere"', '"ended": "2026-11-21T16:00:00"']
)
async def test_a_file_that_no_start_of_ours_wrote_is_passed_over(
    runs: Runs, session: Session, odd: str
) -> None:
    done = runs.add(QUICK, session.folder, "")
    await runs.wait()
    text = f'{{"kind": "panorama", "session": "small", "state": "failed", {odd}}}'
    (results_folder(session.folder) / "panorama.json").write_text(text)
    await runs.read()
    assert [run.line for run in runs.all] == [done.line]


def test_each_kind_has_a_line_that_one_could_type(session: Session, tmp_path: Path) -> None:
    lines = [kind.line(session.folder, tmp_path / "out", kind.quick) for kind in COMMANDS.values()]
    assert all(
        line.startswith(("reconstruct ", "capture-app sessions ", "capture-app panel read "))
        for line in lines
    )
    assert f"capture-app sessions export {session.folder} --to colmap --out {tmp_path / 'out'}" in lines


def test_time_left_is_reckoned_from_the_steps(tmp_path: Path) -> None:
    job = Run(kind="compare", session=tmp_path, state=RunState.RUNNING, seconds=30.0)
    assert job.seconds_left is None
    job.step = ProgressStep(3, 9, "stereo")
    assert job.fraction == pytest.approx(2 / 9)
    assert job.seconds_left is None, "the first steps are short and tell nothing of the others"
    job.step = ProgressStep(4, 9, "stereo")
    assert job.seconds_left == pytest.approx(60.0)
    job.step = ProgressStep(5, 0, "odd")
    assert job.fraction is None
