"""The mode Shoot as a photographer drives it: keys in, orders to the rig, takes on the screen."""

from pathlib import Path
from typing import Any

import pytest
from textual.pilot import Pilot

from capture_app.protocol.status import Preview
from capture_app.session.library.changes import trashed_sessions
from capture_app.tui.library.session_rows import SessionRows
from capture_app.tui.question import Question
from capture_app.tui.screen_settings import Settings
from capture_app.tui.widgets.look import LookScreen
from tests.unit.tui.driving import screen_of, settle, until
from tests.unit.tui.library.screen import choose, rows, type_text, view
from tests.unit.tui.shoot.studio import Studio, ready_rig, saves_into
from tests.unit.tui.takes import picture_of


async def test_name_and_notes_go_with_the_take(tmp_path: Path) -> None:
    rig = ready_rig(2)
    rig.take = saves_into(tmp_path, cameras=2)
    settings = Settings()
    studio = Studio(rig, tmp_path, settings)
    async with studio.running(120, 40) as pilot:
        await pilot.press("n", *"dancer", "enter", "t", *"left light off", "enter", "space")
        await studio.settle(pilot)
        assert (studio.requests[0].name, studio.requests[0].note) == ("dancer", "left light off")
        assert studio.view.take_panel.plain.startswith("dancer-001")
    assert settings.recall("shoot.name", "") == "dancer"


async def test_a_take_follows_its_session(tmp_path: Path) -> None:
    rig = ready_rig(2)
    rig.take = saves_into(tmp_path, cameras=2)
    studio = Studio(rig, tmp_path)
    async with studio.running(120, 40) as pilot:
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


@pytest.mark.parametrize(("answer", "kept"), [("k", True), ("t", False)])
async def test_a_retake_keeps_or_trashes_the_take_before(tmp_path: Path, answer: str, kept: bool) -> None:
    rig = ready_rig(2)
    rig.take = saves_into(tmp_path, cameras=2)
    studio = Studio(rig, tmp_path)
    async with studio.running(120, 40) as pilot:
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
        assert studio.view.stage.border_title == "Live · 2 pictures within 84 µs"
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
    async with studio.running(120, 40) as pilot:
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
