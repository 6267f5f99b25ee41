"""The mode Shoot as a photographer drives it: keys in, orders to the rig, takes on the screen."""

from pathlib import Path
from typing import Any

from textual.pilot import Pilot
from textual.widgets import Digits, Static

from capture_app.protocol.messages import BurstRequest
from capture_app.rig.taking import Begun, Moved, TakePlan
from capture_app.session.library.listing import list_sessions
from capture_app.tui.screen_settings import Settings
from tests.facts import make_facts
from tests.unit.tui.driving import settle, until
from tests.unit.tui.shoot.studio import Studio, ready_rig, saves_into

COUNTDOWN_S = 3600.0
"""It never ends while a test runs, however long a busy machine takes."""


async def test_space_takes_as_planned_and_the_sheet_is_there_at_once(tmp_path: Path) -> None:
    rig = ready_rig(3)
    rig.take = saves_into(tmp_path)
    studio = Studio(rig, tmp_path)
    async with studio.running(120, 40) as pilot:
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


async def test_a_bad_name_is_not_taken(tmp_path: Path) -> None:
    studio = Studio(ready_rig(1), tmp_path)
    async with studio.running() as pilot:
        await pilot.press("n", *"../x", "enter")
        await pilot.pause()
        assert "letters, digits" in str(studio.app.screen.query_one(".wrong", Static).content)
        await pilot.press("escape")
        await pilot.pause()
        assert studio.view.plan_panel.settings.name == ""


async def test_a_recording_is_found_by_its_name_and_taken(tmp_path: Path) -> None:
    studio = Studio(ready_rig(2), tmp_path)
    async with studio.app.run_test(size=(80, 24)) as pilot:
        await pilot.press("2")
        await settle(pilot)
        found = [command.title for command in studio.app.get_system_commands(studio.app.screen)]
        assert any(title.startswith("Record") for title in found)
        await pilot.press("F")
        await settle(pilot)
        await pilot.press("end", "enter")
        await settle(pilot)
        assert studio.view.plan_panel.settings.plan().video


async def test_the_plan_is_changed_with_arrows(tmp_path: Path) -> None:
    studio = Studio(ready_rig(1), tmp_path)
    async with studio.running() as pilot:
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


async def test_the_plan_is_changed_by_clicks_and_texts_by_arrows_too(tmp_path: Path) -> None:
    studio = Studio(ready_rig(1), tmp_path)
    async with studio.running(120, 40) as pilot:
        panel = studio.view.plan_panel
        await pilot.click(panel, offset=(3, 2))
        assert panel.plain[1].startswith("after     ‹ 5"), "the first click selects"
        await pilot.click(panel, offset=(panel.size.width - 2, 2))
        await pilot.click(panel, offset=(3, 2))
        await pilot.click(panel, offset=(3, 2))
        assert panel.settings.after == 4
        await pilot.click(panel, offset=(3, len(panel.plain) + 1))
        assert panel.plain[1].startswith("after     ‹ 4"), "there is no setting below the last"
        await pilot.press("down", "down", "down", "right", *"walk", "enter")
        await studio.settle(pilot)
        assert panel.settings.name == "walk"


async def test_a_countdown_is_seen_from_afar_and_can_be_stopped(tmp_path: Path) -> None:
    studio = Studio(ready_rig(1), tmp_path, Settings(choices={"shoot.countdown_s": COUNTDOWN_S}))
    async with studio.running() as pilot:
        await pilot.press("space")
        await until(pilot, lambda: studio.view.stage.current == "countdown")
        assert COUNTDOWN_S - 600 < int(studio.view.query_one(Digits).value) <= COUNTDOWN_S
        await pilot.press("space")
        await until(pilot, lambda: studio.view.stage.current == "live")
        assert studio.requests == []


async def test_what_a_take_waits_for_and_what_began_it_are_said(tmp_path: Path) -> None:
    studio = Studio(ready_rig(1), tmp_path)
    studio.rig.change("cam00", camera=make_facts(label="Böhm"))
    async with studio.running(120, 40) as pilot:
        plan = TakePlan(repeat=2)
        studio.view._show_event(Moved(2, camera="cam00"), plan, "")
        studio.view._show_event(Begun(2), plan, "")
        await studio.settle(pilot)
        assert [one.message for one in studio.app._notifications] == ["something moves in front of Böhm"]
        assert studio.view._line.plain == ("◉ take 2 of 2 is being taken",)


async def test_the_screen_may_be_left_during_a_countdown(tmp_path: Path) -> None:
    studio = Studio(ready_rig(1), tmp_path, Settings(choices={"shoot.countdown_s": COUNTDOWN_S}))
    async with studio.running() as pilot:
        await pilot.press("space")
        await until(pilot, lambda: studio.view.stage.current == "countdown")
    assert studio.requests == []


async def test_a_sequence_takes_one_after_the_other(tmp_path: Path) -> None:
    rig = ready_rig(3)
    rig.take = saves_into(tmp_path)
    studio = Studio(rig, tmp_path, Settings(choices={"shoot.mode": "sequence", "shoot.takes": 3}))
    async with studio.running(120, 40) as pilot:
        await pilot.press("space")
        while len(studio.requests) < 3:
            await pilot.pause(0.01)
        await studio.settle(pilot)
        text = studio.view.take_panel.plain
        assert text.startswith("burst-003")
        earlier = [line for line in text.splitlines() if line.startswith("burst-00")][1:]
        assert earlier == ["burst-002  ● excellent 40 µs ±18 µs", "burst-001  ● excellent 20 µs ±18 µs"]
        assert [one.name for one in list_sessions(tmp_path)] == ["burst-001", "burst-002", "burst-003"]


async def test_a_take_from_before_is_shown_but_not_over_what_is_live(tmp_path: Path) -> None:
    rig = ready_rig(3)
    rig.take = saves_into(tmp_path)
    async for _ in rig.burst(BurstRequest(frames=2, name="before")):
        pass
    studio = Studio(rig, tmp_path)
    async with studio.running(120, 40) as pilot:
        assert studio.view.take_panel.plain.startswith("before-001\n● excellent")
        assert not studio.view.stage.is_sheet
        await pilot.press("v")
        assert studio.view.stage.is_sheet
        await pilot.press("escape")
        assert not studio.view.stage.is_sheet


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
    async with studio.running(120, 40) as pilot:
        await pilot.press("m")
        await studio.settle(pilot)
        assert ("mark", "mark") in rig.asked
        assert [one.message for one in studio.app._notifications] == ["marked in burst-001"]


async def test_a_line_that_is_too_long_goes_on_below(tmp_path: Path) -> None:
    studio = Studio(ready_rig(2), tmp_path)
    async with studio.running() as pilot:
        studio.view._failure = "cam03 has not answered for 12 s; " * 4 + "start it again with a key"
        studio.view._show_course()
        await studio.settle(pilot)
        line = studio.view._line
        assert " ".join(line.plain).split() == f"! no take: {studio.view._failure}".split()
        assert line.size.height == len(line.plain) == 3
