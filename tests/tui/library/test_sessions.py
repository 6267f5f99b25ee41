"""What is done with sessions on the screen is done on disk."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from textual.widgets import Input, OptionList

from capture_app.session.format.burst_plan import BurstPlan, CameraPlan
from capture_app.session.format.manifest import MANIFEST, BurstRecord
from capture_app.session.library.changes import set_note
from capture_app.session.library.trash import trashed_sessions
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.tui.jobs.job import JobState
from capture_app.tui.jobs.result_screen import ResultScreen
from capture_app.tui.library.take_screen import TakeScreen
from capture_app.tui.messages import SessionsRequested
from capture_app.tui.pictures.picture import Picture
from capture_app.tui.settings import Settings
from capture_app.tui.sheets.contact_sheet import ContactSheet
from capture_app.tui.sheets.look import LookScreen
from tests.session.conftest import camera_record, jpeg
from tests.tui.driving import settle, toasts
from tests.tui.library.screen import choose, library, rows, text, type_text, until, view
from tests.tui.takes import make_take


def names(pilot: Any) -> list[str]:
    return [Path(key).name for key in rows(pilot.app).keys if "sample_sessions" not in key]


def jobs(pilot: Any) -> list[Any]:
    return pilot.app.jobs.jobs


async def test_what_is_there_at_the_start_is_shown_and_what_comes_later(sessions: Path) -> None:
    async with library(sessions) as pilot:
        assert set(names(pilot)) == {"one", "two", "three"}
        shown = text(pilot.app)
        assert "1.4 ms ±18 µs apart" in shown
        assert "3 cameras × 3 instants" in shown
        make_take(sessions, name="four", note="a note")
        await until(pilot, lambda: "four" in names(pilot))
        set_note(sessions / "four", "another")
        await until(pilot, lambda: "another" in text(pilot.app))


async def test_the_best_synchronized_is_marked_and_sorted_first(sessions: Path) -> None:
    settings = Settings()
    async with library(sessions, settings=settings) as pilot:
        line = next(line for line in text(pilot.app).splitlines() if "★" in line)
        assert "two" in line
        assert "best synchronized" in line
        await pilot.press("s")
        await settle(pilot)
        assert names(pilot) == ["two", "one", "three"]
        assert view(pilot.app).entry.card.name == "two"
        await pilot.press("s")
        await settle(pilot)
        assert names(pilot) == ["one", "three", "two"]
    assert settings.choices["sessions.order"] == "by name"


async def test_find_by_words(sessions: Path) -> None:
    set_note(sessions / "one", "the dancer left")
    async with library(sessions) as pilot:
        await pilot.press("slash", *"dancer")
        await settle(pilot)
        assert names(pilot) == ["one"]
        await pilot.press(*"xyz", "enter")
        await settle(pilot)
        assert rows(pilot.app).keys == ()
        await pilot.press("escape")
        await settle(pilot)
        assert len(names(pilot)) == 3


async def test_rename(sessions: Path) -> None:
    async with library(sessions) as pilot:
        await choose(pilot, "one")
        await pilot.press("r")
        await settle(pilot)
        await type_text(pilot, "two")
        await pilot.press("enter")
        await settle(pilot)
        assert pilot.app.screen.query(Input), "a name in use is not taken"
        await type_text(pilot, "jump")
        await pilot.press("enter")
        await until(pilot, lambda: "jump" in names(pilot))
        assert view(pilot.app).entry.card.name == "jump"
    assert Session.open(sessions / "jump").name == "jump"
    assert verify(Session.open(sessions / "jump")) == []
    assert not (sessions / "one").exists()


async def test_note_trash_and_undo(sessions: Path) -> None:
    async with library(sessions) as pilot:
        await choose(pilot, "two")
        await pilot.press("n")
        await settle(pilot)
        await type_text(pilot, "[red]best[/red] one")
        await pilot.press("enter")
        await until(pilot, lambda: "[red]best[/red] one" in text(pilot.app))
        assert Session.open(sessions / "two").manifest.note == "[red]best[/red] one"
        await pilot.press("d")
        await until(pilot, lambda: "two" not in names(pilot))
        assert not (sessions / "two").exists()
        assert [one.name for one in trashed_sessions(sessions)] == ["two"]
        assert any("u brings it back" in toast for toast in toasts(pilot.app))
        await pilot.press("u")
        await until(pilot, lambda: "two" in names(pilot))
        await until(pilot, lambda: view(pilot.app).entry.card.name == "two")
    assert verify(Session.open(sessions / "two")) == []


async def test_undo_with_an_empty_trash_says_so(sessions: Path) -> None:
    async with library(sessions) as pilot:
        await pilot.press("u")
        await until(pilot, lambda: any("is empty" in toast for toast in toasts(pilot.app)))


async def test_look_at_a_take_and_a_picture(sessions: Path) -> None:
    async with library(sessions, (80, 24)) as pilot:
        await choose(pilot, "one")
        await pilot.press("enter")
        await until(pilot, lambda: isinstance(pilot.app.screen, TakeScreen))
        await pilot.press("right", "down", "enter")
        await until(pilot, lambda: isinstance(pilot.app.screen, LookScreen))
        assert pilot.app.screen.shown == ("cam01", 1)
        await pilot.press("escape")
        await settle(pilot)
        await pilot.press("b")
        await until(pilot, lambda: isinstance(pilot.app.screen, LookScreen))
        await pilot.press("escape", "escape")
        await until(pilot, lambda: not isinstance(pilot.app.screen, TakeScreen | LookScreen))


async def test_export_to_colmap(sessions: Path, tmp_path: Path) -> None:
    async with library(sessions) as pilot:
        await choose(pilot, "one")
        await pilot.press("e")
        await settle(pilot)
        line = pilot.app.screen.query_one(Input)
        assert line.value == str(tmp_path / "one-colmap")
        await pilot.press("tab")
        await type_text(pilot, str(sessions))
        await pilot.press("enter")
        await settle(pilot)
        assert pilot.app.screen.query(OptionList), "a folder with something in it is refused"
        await type_text(pilot, str(tmp_path / "for colmap"))
        await pilot.press("enter")
        await until(pilot, lambda: jobs(pilot) and jobs(pilot)[0].state is JobState.DONE)
    found = sorted(p.name for p in (tmp_path / "for colmap" / "images" / "rig1" / "cam00").iterdir())
    assert found == ["000000.jpg", "000001.jpg", "000002.jpg"]
    assert json.loads((tmp_path / "for colmap" / "rig_config.json").read_text())


async def test_verify_tells_what_is_wrong(sessions: Path) -> None:
    image = sessions / "one" / "images" / "rig1" / "cam01" / "000002.jpg"
    image.write_bytes(image.read_bytes()[:-1])
    async with library(sessions) as pilot:
        await choose(pilot, "one")
        await pilot.press("v")
        await until(pilot, lambda: jobs(pilot) and jobs(pilot)[0].state.is_over)
        assert jobs(pilot)[0].state is JobState.FAILED
        await until(pilot, lambda: "✖ verify" in text(pilot.app))
        await pilot.press("4")
        await settle(pilot)
        assert "cam01/000002.jpg" in jobs(pilot)[0].message


async def test_an_interrupted_session_says_what_to_do_and_can_be_thrown_away(sessions: Path) -> None:
    writer = SessionWriter.create(sessions, "cut")
    writer.add_image(b"x", camera="cam00", instant=0, leader_ns=5)
    async with library(sessions) as pilot:
        await until(pilot, lambda: "being saved" in text(pilot.app))
        await choose(pilot, "cut")
        assert view(pilot.app).check_action("trash", ()) is False
        writer.abort()
        await until(pilot, lambda: "interrupted" in text(pilot.app))
        await choose(pilot, "cut")
        assert view(pilot.app).check_action("look", ()) is False
        assert view(pilot.app).check_action("compare", ()) is False
        await pilot.press("d")
        await until(pilot, lambda: "cut" not in names(pilot))
    assert [one.name for one in trashed_sessions(sessions)] == ["cut"]


async def test_an_interrupted_session_is_repaired_by_a_job(sessions: Path) -> None:
    camera = camera_record("left")
    burst = BurstRecord(instants_ns=(10**9, 2 * 10**9), period_ns=33_000_000)
    writer = SessionWriter.create(sessions, "cut")
    plan = {"created": writer.created, "software": writer.software, "leader": 1, "number": 1}
    writer.set_plan(BurstPlan(name="cut", burst=burst, cameras=(CameraPlan(camera=camera),), **plan))
    writer.add_image(jpeg(1), camera="left", instant=0, leader_ns=10**9)
    writer.abort()
    async with library(sessions) as pilot:
        await choose(pilot, "cut")
        await pilot.press("a")
        await settle(pilot)
        await pilot.press("enter")
        await until(pilot, lambda: jobs(pilot) and jobs(pilot)[0].state.is_over)
        assert jobs(pilot)[0].message == "completed: 1 image, 1 missing"
        await until(pilot, lambda: "! 1 image missing" in text(pilot.app))
    assert len(Session.open(sessions / "cut").manifest.images) == 1


async def test_samples_are_shown_and_left_as_they_are(sessions: Path) -> None:
    async with library(sessions) as pilot:
        sample = next(key for key in rows(pilot.app).keys if key.endswith("sample_sessions/jumper"))
        rows(pilot.app).choose(sample)
        await settle(pilot)
        for action in ("rename", "note", "trash"):
            assert view(pilot.app).check_action(action, ()) is False
        assert view(pilot.app).check_action("compare", ()) is True


@pytest.mark.parametrize("name", ["[bold]evil[blink]", "\x1b[2J\x07", "x" * 200, "ünï日本"])
async def test_names_from_elsewhere_are_text(sessions: Path, name: str) -> None:
    shutil.copytree(sessions / "one", sessions / name)
    manifest = json.loads((sessions / name / MANIFEST).read_text())
    manifest["note"] = "\x1b]0;title\x07[link=x]click[/link]" + "y" * 5000
    (sessions / name / MANIFEST).write_text(json.dumps(manifest))
    async with library(sessions, (80, 24)) as pilot:
        key = str(sessions / name)
        rows(pilot.app).choose(key)
        await settle(pilot)
        shown = text(pilot.app)
        assert "\x1b" not in shown
        assert "\x07" not in shown
        assert all(len(line) <= 80 for line in shown.splitlines())
        if name.startswith("["):
            assert "[bold]evil[blink]" in shown
        for keys in ("r", "n", "e", "a"):
            await pilot.press(keys)
            await settle(pilot)
            await pilot.press("escape")
            await settle(pilot)
        await pilot.press("enter")
        await until(pilot, lambda: isinstance(pilot.app.screen, TakeScreen))
        await pilot.press("escape")


@pytest.mark.slow
async def test_a_real_comparison_from_the_key_to_its_depth(sessions: Path) -> None:
    sample = Path(__file__).parents[3] / "sample_sessions" / "crossing"
    shutil.copytree(sample, sessions / "crossing")
    async with library(sessions) as pilot:
        await until(pilot, lambda: "crossing" in names(pilot))
        rows(pilot.app).choose(str(sessions / "crossing"))
        await settle(pilot)
        await pilot.press("a", "tab")
        await settle(pilot)
        await type_text(pilot, "--max-multiview-instants 0 --max-instants 1 --no-poses")
        await pilot.press("enter")
        await until(pilot, lambda: jobs(pilot) and jobs(pilot)[0].state.is_over)
        (job,) = jobs(pilot)
        assert (job.state, job.kind.name) == (JobState.DONE, "compare"), job.message
        assert job.out == sessions / "_results" / "crossing" / "compare"
        assert (job.out / "report.html").is_file()
        await pilot.press("o")
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


async def test_another_view_can_ask_for_a_session_for_samples_and_for_another_folder(
    sessions: Path, tmp_path: Path
) -> None:
    make_take(tmp_path / "elsewhere", name="far")
    samples = Path(__file__).parents[3] / "sample_sessions"
    async with library(sessions) as pilot:
        for folder, session, expected in (
            (sessions, "one", "one"),
            (samples, None, "crossing"),
            (sessions, None, "three"),
            (tmp_path / "elsewhere", None, "far"),
        ):
            await pilot.press("1")
            await settle(pilot)
            pilot.app.screen.post_message(SessionsRequested(folder, session))
            await until(pilot, lambda: pilot.app.current_mode == "sessions")
            await until(pilot, lambda name=expected: view(pilot.app).entry.card.name == name)


async def test_any_size_is_drawn(sessions: Path) -> None:
    async with library(sessions) as pilot:
        for size in ((20, 8), (3, 2), (300, 90)):
            await pilot.resize_terminal(*size)
            await pilot.press("down", "a", "escape", "e", "escape", "slash", "escape")
            await settle(pilot)
        await pilot.press("enter")
        await until(pilot, lambda: isinstance(pilot.app.screen, TakeScreen))
        for size in ((20, 8), (3, 2), (80, 24)):
            await pilot.resize_terminal(*size)
            await pilot.press("right", "down")
            await settle(pilot)
        assert pilot.app.screen.query_one(ContactSheet).cursor.x > 0
