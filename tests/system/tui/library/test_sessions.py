"""What is done with sessions on the screen is done on disk."""

import json
import re
import shutil
from functools import partial
from pathlib import Path

import pytest
from textual.widgets import Input, OptionList

from capture_app.session.format.manifest import MANIFEST
from capture_app.session.library.changes import set_note, trashed_sessions
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.tui.app import SimulshotApp
from capture_app.tui.jobs.run import STUDIES
from capture_app.tui.rig_record import SessionsRequested
from capture_app.tui.widgets.contact_sheet import ContactSheet
from capture_app.tui.widgets.look import LookScreen
from tests.project import SAMPLES
from tests.unit.tui.driving import settle, toasts, until
from tests.unit.tui.driving import text as words
from tests.unit.tui.library.screen import choose, library, looks, names, rows, text, type_text, view
from tests.unit.tui.takes import make_take


async def test_what_is_there_at_the_start_is_shown_and_what_comes_later(sessions: Path) -> None:
    async with library(sessions) as pilot:
        assert set(names(pilot)) == {"one", "two", "three"}
        shown = text(pilot.app)
        assert re.search(r"◑ fair  [\d.]+ (ms|µs) ±[\d.]+ (ms|µs)\n", shown)
        assert "3 cameras × 3 instants" in shown
        make_take(sessions, name="four", note="a note")
        await until(pilot, lambda: "four" in names(pilot))
        set_note(sessions / "four", "another")
        await until(pilot, lambda: "another" in text(pilot.app))


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


async def test_note_trash_and_undo(sessions: Path) -> None:
    async with library(sessions) as pilot:
        await choose(pilot, "two")
        await pilot.press("t")
        await settle(pilot)
        await type_text(pilot, "[red]best[/red] one")
        await pilot.press("enter")
        await until(pilot, lambda: "[red]best[/" in text(pilot.app))
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


async def test_another_view_can_ask_for_samples_and_for_another_folder(
    sessions: Path, tmp_path: Path
) -> None:
    make_take(tmp_path / "elsewhere", name="far")
    samples = SAMPLES
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


async def test_calibrating_from_a_board_begins_with_what_the_cameras_have_not_seen(sessions: Path) -> None:
    async with library(sessions) as pilot:
        await choose(pilot, "one")
        await pilot.press("A", *["down"] * [study.name for study in STUDIES].index("calibrate"), "enter")
        await settle(pilot)
        offered = [str(option.prompt) for option in pilot.app.screen.query_one(OptionList).options]
        place = next(number for number, prompt in enumerate(offered) if "live" in prompt)
        await pilot.press(*["down"] * place, "enter")
        await until(pilot, lambda: pilot.app.screen.id == "coverage-guide")
        await until(pilot, lambda: "has not seen the board yet" in words(pilot.app, "#coverage-words"))
