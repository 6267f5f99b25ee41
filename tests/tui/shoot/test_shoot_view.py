"""The mode Shoot as a photographer drives it: keys in, orders to the rig, takes on the screen."""

from pathlib import Path
from typing import Any

import pytest
from textual.pilot import Pilot
from textual.widgets import Digits, Static

from capture_app.protocol.messages import BurstRequest
from capture_app.protocol.status import Preview
from capture_app.session.library.changes import trashed_sessions
from capture_app.session.library.listing import list_sessions
from capture_app.tui.library.session_rows import SessionRows
from capture_app.tui.question import Question
from capture_app.tui.screen_settings import Settings
from capture_app.tui.widgets.look import LookScreen
from tests.tui.driving import screen_of, settle, until
from tests.tui.library.screen import choose, rows, type_text, view
from tests.tui.shoot.studio import Studio, ready_rig, saves_into
from tests.tui.takes import picture_of

COUNTDOWN_S = 3600.0
"""It never ends while a test runs, however long a busy machine takes."""


async def test_space_takes_as_planned_and_the_sheet_is_there_at_once(tmp_path: Path) -> None:
    rig = ready_rig(3)
    rig.take = saves_into(tmp_path)
    studio = Studio(rig, tmp_path)
    async with studio.app.run_test(size=(120, 40)) as pilot:
        await studio.enter(pilot)
        assert "No take yet: press Space." in studio.view.take_panel.plain
        await pilot.press("right_square_bracket", "right_curly_bracket", "right_curly_bracket", "space")
        await studio.settle(pilot)
        assert [(r.frames, r.before) for r in studio.requests] == [(11, 4)]
        sheet = studio.view.stage.sheet
        assert studio.view.stage.is_sheet
        assert sheet.sheet is not None
        assert sheet.sheet.session.folder == tmp_path / "burst-001"
        assert sheet.cursor == (0, 4), "the instant of the key"
        text = studio.view.take_panel.plain
        assert "burst-001\n● excellent 20 µs ±18 µs" in text
        await pilot.press("y")
        await studio.settle(pilot)
        why = str(studio.app.screen.query_one("BoxDialog Static", Static).content)
        assert "Excellent: within a pixel for motion up to 26,000 px/s; all 33 images there" in why
        await pilot.press("escape")


@pytest.mark.slow
async def test_name_and_notes_go_with_the_take(tmp_path: Path) -> None:
    rig = ready_rig(2)
    rig.take = saves_into(tmp_path, cameras=2)
    settings = Settings()
    studio = Studio(rig, tmp_path, settings)
    async with studio.app.run_test(size=(120, 40)) as pilot:
        await studio.enter(pilot)
        await pilot.press("n", *"dancer", "enter", "t", *"left light off", "enter", "space")
        await studio.settle(pilot)
        assert (studio.requests[0].name, studio.requests[0].note) == ("dancer", "left light off")
        assert studio.view.take_panel.plain.startswith("dancer-001")
    assert settings.recall("shoot.name", "") == "dancer"


async def test_a_bad_name_is_not_taken(tmp_path: Path) -> None:
    studio = Studio(ready_rig(1), tmp_path)
    async with studio.app.run_test(size=(80, 24)) as pilot:
        await studio.enter(pilot)
        await pilot.press("n", *"../x", "enter")
        await pilot.pause()
        assert "letters, digits" in str(studio.app.screen.query_one(".wrong", Static).content)
        await pilot.press("escape")
        await pilot.pause()
        assert studio.view.plan_panel.settings.name == ""


async def test_the_plan_is_changed_with_arrows(tmp_path: Path) -> None:
    studio = Studio(ready_rig(1), tmp_path)
    async with studio.app.run_test(size=(80, 24)) as pilot:
        await studio.enter(pilot)
        await pilot.press("left", "down", "right", "down", "right", "down", "right")
        plan = studio.view.plan_panel.settings
        assert (plan.before, plan.after, plan.countdown_s, plan.mode) == (2, 6, 3, "interval")
        lines = studio.view.plan_panel.plain
        assert lines[0].startswith("before    2  -67 ms")
        assert lines[3] == "mode      ‹ interval ›"
        assert lines[4] == "every     5 s"
        await pilot.press("right", "right", "right")
        assert "mode      ‹ recording ›" in studio.view.plan_panel.plain, "it has fewer settings above it"
        await pilot.press("right")
        assert studio.view.plan_panel.plain[3] == "mode      ‹ single ›"


async def test_a_countdown_is_seen_from_afar_and_can_be_stopped(tmp_path: Path) -> None:
    studio = Studio(ready_rig(1), tmp_path, Settings(choices={"shoot.countdown_s": COUNTDOWN_S}))
    async with studio.app.run_test(size=(80, 24)) as pilot:
        await studio.enter(pilot)
        await pilot.press("space")
        await until(pilot, lambda: studio.view.stage.current == "countdown")
        assert COUNTDOWN_S - 600 < int(studio.view.query_one(Digits).value) <= COUNTDOWN_S
        await pilot.press("space")
        await until(pilot, lambda: studio.view.stage.current == "live")
        assert studio.requests == []


async def test_the_screen_may_be_left_during_a_countdown(tmp_path: Path) -> None:
    studio = Studio(ready_rig(1), tmp_path, Settings(choices={"shoot.countdown_s": COUNTDOWN_S}))
    async with studio.app.run_test(size=(80, 24)) as pilot:
        await studio.enter(pilot)
        await pilot.press("space")
        await until(pilot, lambda: studio.view.stage.current == "countdown")
    assert studio.requests == []


async def test_a_sequence_takes_one_after_the_other(tmp_path: Path) -> None:
    rig = ready_rig(3)
    rig.take = saves_into(tmp_path)
    studio = Studio(rig, tmp_path, Settings(choices={"shoot.mode": "sequence", "shoot.takes": 3}))
    async with studio.app.run_test(size=(120, 40)) as pilot:
        await studio.enter(pilot)
        await pilot.press("space")
        while len(studio.requests) < 3:
            await pilot.pause(0.01)
        await studio.settle(pilot)
        text = studio.view.take_panel.plain
        assert text.startswith("burst-003")
        earlier = [line for line in text.splitlines() if line.startswith("burst-00")][1:]
        assert earlier == ["burst-002  ● excellent 40 µs ±18 µs", "burst-001  ● excellent 20 µs ±18 µs"]
        assert [one.name for one in list_sessions(tmp_path)] == ["burst-001", "burst-002", "burst-003"]


async def test_a_take_follows_its_session(tmp_path: Path) -> None:
    rig = ready_rig(2)
    rig.take = saves_into(tmp_path, cameras=2)
    studio = Studio(rig, tmp_path)
    async with studio.app.run_test(size=(120, 40)) as pilot:
        await studio.enter(pilot)
        await pilot.press("space")
        await studio.settle(pilot)
        shoot = studio.view
        await pilot.press("3")
        await until(pilot, lambda: studio.app.screen.query(SessionRows) and rows(studio.app).keys)
        await choose(pilot, "burst-001")
        await pilot.press("n")
        await settle(pilot)
        await type_text(pilot, "walk")
        await pilot.press("enter")
        await until(pilot, lambda: shoot.take_panel.plain.startswith("walk\n● excellent"))
        sheet = shoot.stage.sheet.sheet
        assert sheet is not None
        assert sheet.session.folder == tmp_path / "walk"
        await until(pilot, lambda: view(studio.app).entry and view(studio.app).entry.card.name == "walk")
        await pilot.press("delete")
        await until(pilot, lambda: "in the trash" in shoot.take_panel.plain)
        await pilot.press("u")
        await until(pilot, lambda: "● excellent" in shoot.take_panel.plain)
        rig.tell()
        await studio.settle(pilot)
        assert len(shoot.takes) == 1, "the rig's status still has the first name"


@pytest.mark.slow
@pytest.mark.parametrize(("answer", "kept"), [("k", True), ("t", False)])
async def test_a_retake_keeps_or_trashes_the_take_before(tmp_path: Path, answer: str, kept: bool) -> None:
    rig = ready_rig(2)
    rig.take = saves_into(tmp_path, cameras=2)
    studio = Studio(rig, tmp_path)
    async with studio.app.run_test(size=(120, 40)) as pilot:
        await studio.enter(pilot)
        await pilot.press("space")
        await studio.settle(pilot)
        await pilot.press("v", "right", "right", "r")
        await pilot.pause()
        assert isinstance(studio.app.screen, Question)
        await pilot.press(answer)
        await studio.settle(pilot)
        assert studio.requests[0] == studio.requests[1], "the same settings, whatever the plan says now"
        assert (tmp_path / "burst-001").exists() is kept
        assert [one.name for one in trashed_sessions(tmp_path)] == ([] if kept else ["burst-001"])
        assert (tmp_path / "burst-002").is_dir()
        assert ("in the trash" in studio.view.take_panel.plain) is not kept


async def test_previews_are_asked_for_only_while_they_are_seen(tmp_path: Path) -> None:
    rig = ready_rig(4)
    rig.take = saves_into(tmp_path, cameras=4)
    studio = Studio(rig, tmp_path)
    async with studio.app.run_test(size=(120, 40)) as pilot:
        await pilot.pause()
        assert studio.wishes == []
        await studio.enter(pilot)
        assert studio.wishes == [(None, 128, 2.5)]
        rig.preview("cam02", picture_of(3), 64, 48)
        await studio.settle(pilot)
        tiles = studio.view.stage.grid.tiles
        assert [tile.picture.cells is not None for tile in tiles] == [False, False, True, False]
        assert tiles[2].title.strip() == "● cam02 ready 30.0 fps"
        assert studio.view.stage.border_title == "Live"
        shown: dict[str, Any] = {"instant_ns": 5, "width": 64, "height": 48, "jpeg": picture_of(3)}
        rig.tell(Preview(camera="cam00", leader_ns=10**9, **shown))
        rig.tell(Preview(camera="cam02", leader_ns=10**9 + 84_000, completes=True, **shown))
        await studio.settle(pilot)
        assert studio.view.stage.border_title == "Live · 2 pictures of one instant, within 84 µs"
        await pilot.press("1")
        await studio.settle(pilot)
        assert studio.wishes[1:] == [(None, 128, 0.0)]
        await pilot.press("2")
        await studio.settle(pilot)
        assert studio.wishes[2:] == [(None, 128, 2.5)]
        await pilot.press("space")
        await studio.settle(pilot)
        assert studio.wishes[3:] == [(None, 128, 0.0)], "the sheet is shown"


async def test_enter_opens_a_picture_and_w_wiggles(tmp_path: Path) -> None:
    rig = ready_rig(3)
    rig.take = saves_into(tmp_path)
    studio = Studio(rig, tmp_path)
    async with studio.app.run_test(size=(120, 40)) as pilot:
        await studio.enter(pilot)
        await pilot.press("space")
        await studio.settle(pilot)
        await pilot.press("right", "down", "enter")
        await pilot.pause()
        look = screen_of(studio.app, LookScreen)
        assert look.shown == ("cam01", 4)
        await pilot.press("right", "escape")
        await studio.settle(pilot)
        assert studio.view.stage.sheet.cursor == (2, 4)
        await pilot.press("w")
        await pilot.pause()
        assert screen_of(studio.app, LookScreen).motion == "wiggle"


async def test_a_take_from_before_is_shown_but_not_over_what_is_live(tmp_path: Path) -> None:
    rig = ready_rig(3)
    rig.take = saves_into(tmp_path)
    async for _ in rig.burst(BurstRequest(frames=2, name="before")):
        pass
    studio = Studio(rig, tmp_path)
    async with studio.app.run_test(size=(120, 40)) as pilot:
        await studio.enter(pilot)
        assert studio.view.take_panel.plain.startswith("before-001\n● excellent")
        assert not studio.view.stage.is_sheet
        await pilot.press("v")
        assert studio.view.stage.is_sheet


@pytest.mark.parametrize(("stage", "size"), [("live", (80, 24)), ("sheet", (200, 50))])
def test_the_mode_looks_as_it_did(
    snap_compare: Any, size: tuple[int, int], stage: str, tmp_path: Path
) -> None:
    rig = ready_rig(5)
    rig.take = saves_into(tmp_path, cameras=5)
    rig.different["advice"] = "5 cameras ready, clock error ≤ 9.0 µs (95 %)"
    studio = Studio(rig, tmp_path)

    async def before(pilot: Pilot[None]) -> None:
        await studio.enter(pilot)
        for number, node in enumerate(rig.nodes):
            rig.preview(node.name, picture_of(number), 64, 48)
        await studio.settle(pilot)
        if stage == "sheet":
            await pilot.press("space")
        await studio.settle(pilot)

    assert snap_compare(studio.app, terminal_size=size, run_before=before)


def test_it_looks_as_it_did_without_colours(snap_compare: Any, tmp_path: Path) -> None:
    rig = ready_rig(5)
    rig.take = saves_into(tmp_path, cameras=5)
    studio = Studio(rig, tmp_path, Settings(choices={"theme": "no-colour"}))

    async def before(pilot: Pilot[None]) -> None:
        await studio.enter(pilot)
        await pilot.press("space")
        await studio.settle(pilot)

    assert snap_compare(studio.app, terminal_size=(120, 40), run_before=before)


async def test_m_marks_the_take_under_way(tmp_path: Path) -> None:
    rig = ready_rig(2)
    studio = Studio(rig, tmp_path)
    async with studio.app.run_test(size=(120, 40)) as pilot:
        await studio.enter(pilot)
        await pilot.press("m")
        await studio.settle(pilot)
        assert ("mark", "mark") in rig.asked
        assert [one.message for one in studio.app._notifications] == ["marked in burst-001"]
