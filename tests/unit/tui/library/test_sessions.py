"""What is done with sessions on the screen is done on disk."""

import time
from collections import Counter
from pathlib import Path

import pytest
from textual.widgets import Static

from capture_app.session.format.manifest import JOURNAL, BurstRecord, MissingImage
from capture_app.session.library.changes import RESULTS, TRASH, trash_session, trashed_sessions
from capture_app.session.library.listing import SessionCard, SessionListing
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.tui.library.session_rows import ORDERS, TakePane
from capture_app.tui.question import Question, TextQuestion
from capture_app.tui.screen_settings import Settings
from tests.unit.session.conftest import camera_record
from tests.unit.tui.driving import make_app, settle, toasts, until
from tests.unit.tui.driving import text as said
from tests.unit.tui.fake_rig import FakeRig
from tests.unit.tui.library.screen import choose, library, names, rows, text, view
from tests.unit.tui.takes import make_take

LOOK_AGAIN_S = 0.3


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
        await choose(pilot, "one")


async def test_keys_work_in_a_folder_without_sessions_and_on_its_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("capture_app.tui.app.find_samples", lambda sessions: None)
    monkeypatch.setattr("capture_app.tui.library.sessions_view.LOOK_AGAIN_S", 0.05)
    app = make_app(FakeRig(1), sessions=tmp_path)
    async with app.run_test(size=(120, 40), notifications=True) as pilot:
        await pilot.press("3")
        await until(pilot, lambda: "No session in" in said(app, "#sessions-empty"))
        await pilot.press("u")
        await until(pilot, lambda: toasts(app))
        make_take(tmp_path, name="first")
        await until(pilot, lambda: rows(app).keys)
        await choose(pilot, "first")
        await pilot.press("n")
        await until(pilot, lambda: isinstance(app.screen, TextQuestion))


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


async def test_sizes_of_results_and_of_the_trash_are_shown_and_sorted_by(sessions: Path) -> None:
    for place, size in (("one/compare", 2_340_000), ("three/compare", 4_200_000)):
        (sessions / RESULTS / place).mkdir(parents=True)
        (sessions / RESULTS / place / "film.mp4").write_bytes(bytes(size))
    broken = sessions / "broken"
    broken.mkdir()
    (broken / JOURNAL).write_bytes(bytes(3_100_000))
    trash_session(make_take(sessions, name="gone").folder)
    (sessions / TRASH / "gone" / "session" / "more.bin").write_bytes(bytes(5_000_000))
    async with library(sessions) as pilot:
        frame = pilot.app.screen.query_one("#sessions-frame")
        await until(pilot, lambda: "trash 5.0 MB" in str(frame.border_title))
        await pilot.press(*["less_than_sign"] * ORDERS.index("largest first"))
        await settle(pilot)
        assert names(pilot) == ["three", "broken", "one", "two"]
        assert "0.0 MB + results 4.2 " in text(pilot.app)
        assert " 3.1 MB · → " in text(pilot.app).splitlines()[5], "all of a take without a manifest"
        await pilot.press("E")
        await until(pilot, lambda: isinstance(pilot.app.screen, Question))
        assert "1 session, 5.0 MB" in str(pilot.app.screen.query_one(".question", Static).content)


async def test_undo_with_an_empty_trash_says_so(sessions: Path) -> None:
    async with library(sessions) as pilot:
        await pilot.press("u")
        await until(pilot, lambda: any("is empty" in toast for toast in toasts(pilot.app)))


async def test_the_trash_is_emptied_after_a_question(sessions: Path) -> None:
    async with library(sessions) as pilot:
        facts = pilot.app.screen.query_one(TakePane)
        await until(pilot, lambda: " MB · " in str(facts.border_subtitle))
        await pilot.press("delete")
        await until(pilot, lambda: len(trashed_sessions(sessions)) == 1)
        for key in ("k", "d"):
            assert len(trashed_sessions(sessions)) == 1
            await pilot.press("E")
            await until(pilot, lambda: isinstance(pilot.app.screen, Question))
            assert "has 1 session, 0.0 MB." in str(pilot.app.screen.query_one(".question", Static).content)
            await pilot.press(key)
            await settle(pilot)
        await until(pilot, lambda: not trashed_sessions(sessions))
        assert any("1 session deleted" in toast for toast in toasts(pilot.app))


async def test_a_restored_session_is_not_called_trashed(sessions: Path) -> None:
    async with library(sessions) as pilot:
        await choose(pilot, "one")
        await pilot.press("delete")
        await until(pilot, lambda: any("one is in the trash" in toast for toast in toasts(pilot.app)))
        await pilot.press("u")
        await until(pilot, lambda: "one" in names(pilot))
        await until(pilot, lambda: not toasts(pilot.app))


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


async def test_a_session_of_one_camera_is_not_compared(sessions: Path) -> None:
    make_take(sessions, name="alone", cameras=1)
    async with library(sessions) as pilot:
        await choose(pilot, "alone")
        await pilot.press("c")
        await until(pilot, lambda: toasts(pilot.app))
        assert toasts(pilot.app) == ["alone has one camera: nothing to compare"]


async def test_samples_are_shown_and_left_as_they_are(sessions: Path) -> None:
    async with library(sessions) as pilot:
        sample = next(key for key in rows(pilot.app).keys if key.endswith("sample_sessions/jumper"))
        rows(pilot.app).choose(sample)
        await settle(pilot)
        await pilot.press("n", "t", "delete")
        await until(pilot, lambda: len(toasts(pilot.app)) == 3)
        assert set(toasts(pilot.app)) == {
            "jumper is a sample that comes with simulshot, and stays as it is"
        }, "each key says why"
        assert sample in rows(pilot.app).keys
        assert view(pilot.app).check_action("on_session", ("compare",)) is True
