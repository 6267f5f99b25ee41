"""Jobs that are started from the list of sessions: their forms, and what they leave."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from textual.widgets import Input, Static

from capture_app.companions.exporting.export_session import export_session
from capture_app.session.format.burst_plan import BurstPlan, CameraPlan
from capture_app.session.format.manifest import BurstRecord
from capture_app.session.reading.reader import Session
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.tui.jobs.result_screen import ResultScreen
from capture_app.tui.jobs.run import COMMANDS, VERIFY, RunState
from capture_app.tui.widgets.picture import Picture
from tests.project import SAMPLES
from tests.unit.session.conftest import camera_record, jpeg
from tests.unit.tui.driving import settle, toasts, until
from tests.unit.tui.library.screen import choose, library, names, rows, text, type_text, view
from tests.unit.tui.library.test_session_jobs import NO_PATHS, jobs


async def test_export_to_colmap(sessions: Path, tmp_path: Path) -> None:
    async with library(sessions) as pilot:
        await choose(pilot, "one")
        await pilot.press("e", "enter")
        await settle(pilot)
        line = pilot.app.screen.query_one(Input)
        assert line.value == str(tmp_path / "one-colmap")
        await type_text(pilot, str(sessions))
        await pilot.press("enter")
        await settle(pilot)
        assert pilot.app.screen.query(Input), "a folder with something in it is refused"
        await type_text(pilot, str(tmp_path / "for colmap"))
        await pilot.press("enter")
        await until(pilot, lambda: jobs(pilot) and jobs(pilot)[0].state is RunState.DONE)
    found = sorted(p.name for p in (tmp_path / "for colmap" / "images" / "rig1" / "cam00").iterdir())
    assert found == ["000000.jpg", "000001.jpg", "000002.jpg"]
    assert json.loads((tmp_path / "for colmap" / "rig_config.json").read_text())


async def test_an_export_proposes_a_folder_that_is_free_and_says_when_one_is_not(
    sessions: Path, tmp_path: Path
) -> None:
    (tmp_path / "one-colmap").mkdir()
    async with library(sessions) as pilot:
        await choose(pilot, "one")
        await pilot.press("e", "enter")
        await settle(pilot)
        line = pilot.app.screen.query_one(Input)
        assert line.value == str(tmp_path / "one-colmap-2")
        wrong = pilot.app.screen.query_one(".wrong", Static)
        for typed in NO_PATHS:
            await type_text(pilot, typed)
            assert line.value == typed
            assert "does not exist" not in str(wrong.content), "no folder need be there"
        await type_text(pilot, str(sessions))
        await pilot.press("enter")
        await settle(pilot)
        assert "choose another folder" in str(wrong.content)
        assert line.has_focus
        assert not jobs(pilot)
        await pilot.press("x")
        await settle(pilot)
        assert "choose another folder" not in str(wrong.content)


async def test_a_job_says_whether_it_begins_or_waits_and_that_it_ends_with_the_screen(
    sessions: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(COMMANDS, VERIFY.name, replace(VERIFY, module="tests.unit.tui.jobs.quick_command"))
    async with library(sessions) as pilot:
        await choose(pilot, "one")
        await pilot.press("V")
        await until(pilot, lambda: any("It ends when simulshot quits" in t for t in toasts(pilot.app)))
        assert "Verify of one has started: " in toasts(pilot.app)[0]
        await until(pilot, lambda: jobs(pilot)[0].state.is_over)
        pilot.app.runs.hold(True)
        await pilot.press("V")
        await until(pilot, lambda: any("Verify of one is waiting: " in t for t in toasts(pilot.app)))
        pilot.app.runs.hold(False)
        await until(pilot, lambda: jobs(pilot)[0].state.is_over)


async def test_verify_tells_what_is_wrong(sessions: Path) -> None:
    image = sessions / "one" / "images" / "rig1" / "cam01" / "000002.jpg"
    image.write_bytes(image.read_bytes()[:-1])
    async with library(sessions) as pilot:
        await choose(pilot, "one")
        await pilot.press("V")
        await until(pilot, lambda: jobs(pilot) and jobs(pilot)[0].state.is_over)
        assert jobs(pilot)[0].state is RunState.FAILED
        await until(pilot, lambda: "✖ verify" in text(pilot.app))
        await pilot.press("4")
        await settle(pilot)
        assert "cam01/000002.jpg" in jobs(pilot)[0].message


async def test_an_interrupted_session_is_repaired_by_a_job(sessions: Path) -> None:
    camera = camera_record("left")
    burst = BurstRecord(instants_ns=(10**9, 2 * 10**9), period_ns=33_000_000)
    writer = SessionWriter.create(sessions, "cut")
    writer.set_plan(
        BurstPlan(
            name="cut",
            burst=burst,
            cameras=(CameraPlan(camera=camera),),
            created=writer.created,
            software=writer.software,
            leader=1,
            number=1,
        )
    )
    writer.add_image(jpeg(1), camera="left", instant=0, leader_ns=10**9)
    writer.abort()
    async with library(sessions) as pilot:
        await choose(pilot, "cut")
        await pilot.press("A", "enter")
        await settle(pilot)
        await pilot.press("enter")
        await until(pilot, lambda: jobs(pilot) and jobs(pilot)[0].state.is_over)
        assert "completed, 1 image saved, 1 missing" in jobs(pilot)[0].message
        await until(pilot, lambda: "! 1 image missing" in text(pilot.app))
    assert len(Session.open(sessions / "cut").manifest.images) == 1


async def test_a_real_comparison_from_the_key_to_its_depth(sessions: Path) -> None:
    sample = SAMPLES / "crossing"
    shutil.copytree(sample, sessions / "crossing")
    async with library(sessions) as pilot:
        await until(pilot, lambda: "crossing" in names(pilot))
        rows(pilot.app).choose(str(sessions / "crossing"))
        await settle(pilot)
        await pilot.press("A", "enter")
        await settle(pilot)
        await type_text(pilot, "--max-multiview-instants 0 --max-instants 1")
        await pilot.press("enter")
        await until(pilot, lambda: jobs(pilot) and jobs(pilot)[0].state.is_over, seconds=300)
        (job,) = jobs(pilot)
        assert (job.state, job.kind) == (RunState.DONE, "compare"), job.message
        assert job.out == sessions / "_results" / "crossing" / "compare"
        assert (job.out / "report.html").is_file()
        await pilot.press("R")
        await until(pilot, lambda: isinstance(pilot.app.screen, ResultScreen))
        screen = pilot.app.screen
        picture = screen.query_one(Picture)
        await until(pilot, lambda: picture.cells is not None)
        synced = picture.cells
        assert screen.picture.title == "Distance"
        await pilot.press("space")
        await until(pilot, lambda: picture.cells is not synced)
        assert screen.shows_offset
        assert screen.picture.offset.name == "stereo_depth_offset.png"
        await pilot.press("escape")


async def test_a_folder_of_videos_is_imported_by_a_key(sessions: Path, tmp_path: Path) -> None:
    films = tmp_path / "walk"
    export_session(Session.open(sessions / "one"), "mp4", films)
    async with library(sessions) as pilot:
        await pilot.press("I")
        await settle(pilot)
        await type_text(pilot, str(tmp_path / "nowhere"))
        await pilot.press("enter")
        await settle(pilot)
        assert not jobs(pilot), "no folder is there: nothing begins"
        await type_text(pilot, str(films))
        pilot.app.runs.hold(True)
        await pilot.press("enter")
        await settle(pilot)
        await pilot.press("enter")
        await until(pilot, lambda: jobs(pilot))
        frame = view(pilot.app).query_one("#sessions-frame")
        await until(pilot, lambda: "Import of walk" in str(frame.border_subtitle))
        pilot.app.runs.hold(False)
        await until(pilot, lambda: jobs(pilot)[0].state.is_over, seconds=300)
        assert jobs(pilot)[0].message.startswith("walk: imported")
        assert any("3 cameras, 9 images" in line for line in pilot.app.runs.log(jobs(pilot)[0]))
        await until(pilot, lambda: Path(rows(pilot.app).chosen) == sessions / "walk")
    assert len(Session.open(sessions / "walk").manifest.images) == 9


async def test_the_screen_may_end_while_an_imported_session_is_read(sessions: Path, tmp_path: Path) -> None:
    export_session(Session.open(sessions / "one"), "mp4", tmp_path / "walk")
    async with library(sessions) as pilot:
        reading = view(pilot.app)._reading
        await pilot.press("I")
        await settle(pilot)
        await type_text(pilot, str(tmp_path / "walk"))
        await pilot.press("enter")
        await settle(pilot)
        await pilot.press("enter")
        await until(pilot, lambda: jobs(pilot))
        async with reading:
            await until(pilot, lambda: jobs(pilot)[0].state.is_over and reading._waiters, seconds=300)
            pilot.app.workers.cancel_all()
        await settle(pilot)
