"""What is done with sessions on the screen is done on disk."""

import json
import shutil
import time
from collections import Counter
from functools import partial
from pathlib import Path

import pytest
from textual.widgets import Input

from capture_app.session.format.manifest import MANIFEST, BurstRecord, MissingImage
from capture_app.session.library.changes import set_note, trashed_sessions
from capture_app.session.library.listing import SessionCard, SessionListing
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.tui.app import SimulshotApp
from capture_app.tui.rig_record import SessionsRequested
from capture_app.tui.screen_settings import Settings
from capture_app.tui.widgets.contact_sheet import ContactSheet
from capture_app.tui.widgets.look import LookScreen
from tests.session.conftest import camera_record
from tests.tui.driving import settle, toasts, until
from tests.tui.library.screen import choose, library, looks, names, rows, text, type_text, view
from tests.tui.takes import make_take

LOOK_AGAIN_S = 0.3


@pytest.mark.slow
async def test_what_is_there_at_the_start_is_shown_and_what_comes_later(sessions: Path) -> None:
    async with library(sessions) as pilot:
        assert set(names(pilot)) == {"one", "two", "three"}
        shown = text(pilot.app)
        assert "◑ fair  within 1.4 ms" in shown
        assert "3 cameras × 3 instants" in shown
        make_take(sessions, name="four", note="a note")
        await until(pilot, lambda: "four" in names(pilot))
        set_note(sessions / "four", "another")
        await until(pilot, lambda: "another" in text(pilot.app))


async def test_a_folder_that_takes_longer_to_read_than_until_the_next_look_is_shown(
    sessions: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read, at_once = SessionListing.read, Counter[int]()

    def read_slowly(listing: SessionListing) -> list[SessionCard]:
        at_once[id(listing)] += 1
        assert at_once[id(listing)] == 1, "one thread at a time"
        time.sleep(LOOK_AGAIN_S + 0.5)
        at_once[id(listing)] -= 1
        return read(listing)

    monkeypatch.setattr("capture_app.tui.library.sessions_view.LOOK_AGAIN_S", LOOK_AGAIN_S)
    monkeypatch.setattr(SessionListing, "read", read_slowly)
    async with library(sessions) as pilot:
        assert set(names(pilot)) == {"one", "two", "three"}


async def test_the_best_synchronized_is_marked_and_sorted_first(sessions: Path) -> None:
    settings = Settings()
    async with library(sessions, settings=settings) as pilot:
        line = next(line for line in text(pilot.app).splitlines() if "★" in line)
        assert "two" in line
        assert "★ best synchronized " in line
        await pilot.press("less_than_sign")
        await settle(pilot)
        assert names(pilot) == ["two", "one", "three"]
        assert view(pilot.app).entry.card.name == "two"
        await pilot.press("less_than_sign")
        await settle(pilot)
        assert names(pilot) == ["one", "three", "two"]
    assert settings.choices["sessions.order"] == "by name"


@pytest.mark.slow
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
        await pilot.press("n")
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


@pytest.mark.slow
async def test_note_trash_and_undo(sessions: Path) -> None:
    async with library(sessions) as pilot:
        await choose(pilot, "two")
        await pilot.press("t")
        await settle(pilot)
        await type_text(pilot, "[red]best[/red] one")
        await pilot.press("enter")
        await until(pilot, lambda: "[red]best[/red] one" in text(pilot.app))
        assert Session.open(sessions / "two").manifest.note == "[red]best[/red] one"
        await pilot.press("delete")
        await until(pilot, lambda: "two" not in names(pilot))
        assert not (sessions / "two").exists()
        assert [one.name for one in trashed_sessions(sessions)] == ["two"]
        assert any("u restores it" in toast for toast in toasts(pilot.app))
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
        sheet = view(pilot.app).query_one(ContactSheet)
        await until(pilot, lambda: looks(pilot.app) and sheet.sheet)
        await pilot.press("right", "down", "enter")
        await until(pilot, lambda: isinstance(pilot.app.screen, LookScreen))
        assert pilot.app.screen.shown == ("cam01", 1)
        await pilot.press("escape")
        await settle(pilot)
        await pilot.press("b")
        await until(pilot, lambda: isinstance(pilot.app.screen, LookScreen))
        await pilot.press("escape", "escape")
        await until(pilot, lambda: not looks(pilot.app))


@pytest.mark.slow
async def test_an_interrupted_session_says_what_to_do_and_can_be_thrown_away(sessions: Path) -> None:
    writer = SessionWriter.create(sessions, "cut")
    writer.add_image(b"x", camera="cam00", instant=0, leader_ns=5)
    async with library(sessions) as pilot:
        await until(pilot, lambda: "being saved" in text(pilot.app))
        await choose(pilot, "cut")
        for key in ("enter", "c", "delete"):
            await pilot.press(key)
            await settle(pilot)
        assert sum("cut is being saved" in toast for toast in toasts(pilot.app)) == 3
        assert not pilot.app.runs.all
        assert (sessions / "cut").exists()
        writer.abort()
        await until(pilot, lambda: "interrupted" in text(pilot.app))
        await choose(pilot, "cut")
        assert view(pilot.app).check_action("on_session", ("look",)) is False
        assert view(pilot.app).check_action("on_session", ("compare",)) is False
        await pilot.press("delete")
        await until(pilot, lambda: "cut" not in names(pilot))
    assert [one.name for one in trashed_sessions(sessions)] == ["cut"]


async def test_the_cursor_begins_on_the_newest_that_is_saved(sessions: Path) -> None:
    writer = SessionWriter.create(sessions, "four")
    writer.add_image(b"x", camera="cam00", instant=0, leader_ns=5)
    async with library(sessions) as pilot:
        await until(pilot, lambda: "being saved" in text(pilot.app))
        assert names(pilot)[0] == "four"
        assert view(pilot.app).entry.card.name == "three"
        writer.abort()


async def test_where_the_times_error_is_not_known_nothing_is_claimed(sessions: Path) -> None:
    make_take(sessions, name="four", spread_ns=0, uncertainty_ns=None)
    async with library(sessions) as pilot:
        line = text(pilot.app).splitlines()[3 * names(pilot).index("four") + 1]
        assert "not measured" in line
        assert "0 ns" not in line


async def test_a_session_without_images_is_not_compared(sessions: Path) -> None:
    writer = SessionWriter.create(sessions, "empty")
    cameras = [camera_record(name) for name in ("left", "right")]
    gone = [
        MissingImage(camera=one.name, instant=0, reason="the camera dropped the frame") for one in cameras
    ]
    writer.finish(cameras, BurstRecord(instants_ns=(5,), period_ns=33_000_000), gone, origin="simulated")
    async with library(sessions) as pilot:
        await choose(pilot, "empty")
        assert "not taken" in text(pilot.app)
        await pilot.press("c")
        await until(pilot, lambda: toasts(pilot.app))
        assert toasts(pilot.app) == ["empty has no images: nothing to compare"]
        assert view(pilot.app).check_action("on_session", ("look",)) is True


async def test_a_session_of_one_instant_is_not_compared(sessions: Path) -> None:
    make_take(sessions, name="moment", instants=1)
    async with library(sessions) as pilot:
        await choose(pilot, "moment")
        await pilot.press("c")
        await until(pilot, lambda: toasts(pilot.app))
        assert toasts(pilot.app) == ["moment has one instant: no frame can be offset. Take 5 or more"]
        assert not pilot.app.runs.all


async def test_samples_are_shown_and_left_as_they_are(sessions: Path) -> None:
    async with library(sessions) as pilot:
        sample = next(key for key in rows(pilot.app).keys if key.endswith("sample_sessions/jumper"))
        rows(pilot.app).choose(sample)
        await settle(pilot)
        for action in ("rename", "note", "trash"):
            assert view(pilot.app).check_action("on_session", (action,)) is False
        assert view(pilot.app).check_action("on_session", ("compare",)) is True


@pytest.mark.slow
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
        await until(pilot, lambda: looks(pilot.app))
        await pilot.press("escape")


@pytest.mark.slow
async def test_another_view_can_ask_for_samples_and_for_another_folder(
    sessions: Path, tmp_path: Path
) -> None:
    make_take(tmp_path / "elsewhere", name="far")
    samples = Path(__file__).parents[3] / "sample_sessions"
    async with library(sessions) as pilot:
        for folder, expected in (
            (samples, "crossing"),
            (sessions, "three"),
            (tmp_path / "elsewhere", "far"),
        ):
            await pilot.press("1")
            await settle(pilot)
            pilot.app.screen.post_message(SessionsRequested(folder))
            await until(pilot, lambda: pilot.app.current_mode == "sessions")
            await until(pilot, partial(shows_session, pilot.app, expected))


def shows_session(app: SimulshotApp, name: str) -> bool:
    return view(app).entry.card.name == name


@pytest.mark.slow
async def test_any_size_is_drawn(sessions: Path) -> None:
    async with library(sessions) as pilot:
        for size in ((20, 8), (3, 2), (300, 90)):
            await pilot.resize_terminal(*size)
            await pilot.press("down", "A", "escape", "e", "escape", "slash", "escape")
            await settle(pilot)
        await pilot.press("enter")
        await until(pilot, lambda: looks(pilot.app))
        for size in ((20, 8), (3, 2), (80, 24)):
            await pilot.resize_terminal(*size)
            await pilot.press("right", "down")
            await settle(pilot)
        assert pilot.app.screen.query_one(ContactSheet).cursor.x > 0
