"""What holds in all modes: header, keys, settings, and what is said when something fails."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from textual.widgets._toast import Toast

from capture_app.common.errors import BadInputError
from capture_app.tui.app import SimulshotApp
from capture_app.tui.question import Question
from capture_app.tui.rig.rig_view import RigView
from capture_app.tui.rig_record import ActionFailed
from capture_app.tui.screen_settings import Settings
from capture_app.tui.shoot.preview_grid import PreviewTile
from tests.unit.tui.driving import make_app, running, settle, text, toasts
from tests.unit.tui.fake_rig import FakeRig


def header(app: SimulshotApp) -> str:
    return text(app, "#header")


async def test_the_header_says_which_rig_it_is_and_how_ready() -> None:
    rig = FakeRig(5)
    app = make_app(rig)
    async with app.run_test(size=(120, 40)) as pilot:
        await pilot.pause()
        assert "◑ 2 of 4 ready" in header(app)
        assert "192.168.1.5:47010" in header(app)
        assert "112 GB free" in header(app)
        rig.lose_link()
        await pilot.pause()
        assert "✖ leader lost" in header(app)
        rig.tell()
        await pilot.pause()
        assert "◑ 2 of 4 ready" in header(app)


async def test_a_lost_leader_is_said_where_takes_are_made_and_restarted_from_there() -> None:
    rig = FakeRig(3)
    app = make_app(rig)
    async with app.run_test(size=(120, 40)) as pilot:
        await pilot.press("2")
        await pilot.pause()
        titles = [tile.title for tile in app.screen.query(PreviewTile)]
        assert any("● cam00 ready" in title for title in titles)
        assert "Restart leader" not in text(app, "#footer")
        rig.lose_link()
        await pilot.pause()
        titles = [tile.title for tile in app.screen.query(PreviewTile)]
        assert all("? cam0" in title and "unknown" in title and "fps" not in title for title in titles)
        assert "✖ leader lost (l restarts it): 192.168.1.5:47010 does not answer" in text(
            app, "#shoot-advice"
        )
        assert text(app, "#footer").startswith(" l Restart leader")
        rig.tell()
        await pilot.pause()
        assert "● cam00 ready" in app.screen.query(PreviewTile).first().title
        assert "Restart leader" not in text(app, "#footer")


@pytest.mark.parametrize("width", [79, 80, 90])
async def test_keys_for_which_there_is_no_room_are_hinted_at(width: int) -> None:
    app = make_app(FakeRig(5))
    async with app.run_test(size=(width, 24)) as pilot:
        await settle(pilot)
        shown = text(app, "#footer")
        assert ("g Monitor" in shown) != ("…" in shown)


async def test_modes_are_a_key_and_a_click_away_and_hear_of_the_rig() -> None:
    app = make_app(FakeRig(1))
    async with app.run_test(size=(80, 24)) as pilot:
        for key, mode in ("2", "shoot"), ("3", "sessions"), ("4", "jobs"), ("1", "rig"):
            await pilot.press(key)
            await pilot.pause()
            assert app.current_mode == mode
            assert "● 1 of 1 ready" in header(app)
        await pilot.click("#header", offset=(12, 0))
        await pilot.pause()
        assert app.current_mode == "shoot"


async def test_no_key_in_the_footer_is_cut() -> None:
    app = make_app(FakeRig(1))
    async with app.run_test(size=(80, 24)) as pilot:
        for width in (80, 40, 20):
            await pilot.resize_terminal(width, 24)
            await pilot.pause()
            line = text(app, "#footer")
            assert len(line) == width
            assert line.endswith(" ? Help ")


async def test_a_failed_action_is_a_sentence_not_markup() -> None:
    app = make_app(FakeRig(1))
    async with app.run_test(size=(80, 24), notifications=True) as pilot:
        app.screen.post_message(ActionFailed(BadInputError("[red]\x1b[2J is no name", hint="choose another")))
        await settle(pilot)
        assert toasts(app) == ["[red]\\x1b[2J is no name (choose another)"]


def test_settings_come_back_and_broken_files_are_warnings(tmp_path: Path) -> None:
    settings = Settings.load(tmp_path)
    assert not settings.warnings
    settings.remember("shoot.frames", 7)
    settings.remember("theme", "simulshot-light")
    settings.save()
    (tmp_path / "keys.toml").write_text('shoot.take = "t"\n[rig]\nremove = 3\n')
    again = Settings.load(tmp_path)
    assert again.recall("shoot.frames", 5) == 7
    assert again.recall("shoot.frames", "five") == "five"
    assert again.keys == {"shoot.take": "t"}
    assert "rig.remove" in again.warnings[0]
    (tmp_path / "screen.json").write_text("{")
    (tmp_path / "keys.toml").write_text("= =")
    broken = Settings.load(tmp_path)
    assert len(broken.warnings) == 2
    assert broken.recall("shoot.frames", 5) == 5


def test_choices_that_change_faster_than_the_disk_are_all_kept(tmp_path: Path) -> None:
    """A key pressed three times in a moment is three threads that save."""
    settings = Settings(tmp_path)

    def choose(number: int) -> None:
        settings.remember(f"choice-{number}", number)
        settings.save()

    with ThreadPoolExecutor(8) as threads:
        list(threads.map(choose, range(200)))
    again = Settings.load(tmp_path)
    assert not again.warnings
    assert len(again.choices) == 200


async def test_a_changed_key_holds_and_is_shown(tmp_path: Path) -> None:
    settings = Settings(tmp_path, keys={"app.quit": "x"})
    app = make_app(FakeRig(1), settings=settings)
    async with app.run_test(size=(80, 24)) as pilot:
        await pilot.pause()
        assert " x Quit " in text(app, "#footer")


async def test_what_lies_below_a_dialog_is_still_seen() -> None:
    app = make_app(FakeRig(2), started=True)
    async with running(app, 100, 30) as pilot:
        await pilot.press("q")
        await settle(pilot)
        assert isinstance(app.screen, Question)
        seen = app.export_screenshot()
        assert "Quit?" in seen
        assert "cam01" in seen


async def test_a_lost_leader_is_restarted_without_leaving_the_mode() -> None:
    app = make_app(rig := FakeRig(3))
    async with app.run_test(size=(120, 40), notifications=True) as pilot:
        await pilot.press("2")
        rig.lose_link()
        await pilot.pause()
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(RigView, "restart_leader", lambda _: None)
            await pilot.press("l")
            await pilot.pause()
        assert app.current_mode == "shoot"
        assert any("starting a leader at 127.0.0.1:47010" in words for words in toasts(app))


async def test_a_path_in_a_toast_is_one_line_where_the_window_has_room() -> None:
    app = make_app(FakeRig(1))
    async with app.run_test(size=(80, 24), notifications=True) as pilot:
        app.notify("The report is on this machine:\n/home/ada/sessions/results/burst-001/compare/report.html")
        await settle(pilot)
        assert app.screen.query_one(Toast).content_size.height == 2


async def test_ctrl_c_names_the_key_that_quits() -> None:
    app = make_app(FakeRig(1))
    async with app.run_test(notifications=True) as pilot:
        await pilot.press("ctrl+c")
        await pilot.pause()
        assert any("press q to quit" in words for words in toasts(app))


async def test_a_window_without_room_says_so() -> None:
    app = make_app(FakeRig(3))
    async with app.run_test(size=(40, 10)) as pilot:
        await pilot.pause()
        assert not app.screen.query_one(RigView).display or app.screen.query_one(RigView).size.height == 0
        assert app.screen.query_one("#too-small").display
        await pilot.resize_terminal(80, 24)
        await pilot.pause()
        assert app.screen.query_one(RigView).size.height > 10
        assert not app.screen.query_one("#too-small").display
