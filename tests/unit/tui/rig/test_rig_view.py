"""The mode Rig as a user drives it, on rigs of 1, 5 and 20 cameras."""

import asyncio
from pathlib import Path

import pytest

from capture_app.common.errors import BadInputError
from capture_app.common.node_state import NodeState
from capture_app.protocol.orders import AddCamera, RemoveCamera, StaggerCameras
from capture_app.protocol.pairing_messages import Invite
from capture_app.tui.rig.camera_list import CameraList, CameraRows
from capture_app.tui.rig.guide_screens import large
from capture_app.tui.rig_record import RigRecord
from tests.facts import make_facts
from tests.unit.tui.driving import lines, make_app, running, settle, text, toasts
from tests.unit.tui.fake_rig import FakeRig, make_node

ROWS = "#cameras-rows"


@pytest.mark.parametrize(("cameras", "size"), [(1, (80, 24)), (5, (80, 24)), (20, (80, 24)), (20, (200, 50))])
async def test_every_camera_says_its_state_in_a_word_and_a_glyph(cameras: int, size: tuple[int, int]) -> None:
    rig = FakeRig(cameras)
    app = make_app(rig)
    async with app.run_test(size=size) as pilot:
        await settle(pilot)
        shown = text(app, ROWS)
        for node in rig.nodes:
            assert node.name in shown
        assert "● ready" in shown
        if cameras > 1:
            for words in ("◑ aligning", "◔ syncing", "◌ lost 42 s", "+7.3 ms"):
                assert words in shown
        assert all(len(line) <= size[0] for line in lines(app, ROWS))


async def test_five_cameras_fit_a_small_terminal_with_everything_essential() -> None:
    app = make_app(FakeRig(5))
    async with running(app):
        assert len(lines(app, ROWS)) == 15
        assert app.screen.query_one(ROWS).max_scroll_y == 0
        shown = text(app, ROWS)
        for words in ("phase −45 µs", "error ±9.0 µs", "30 fps", "1/100 s", "3 drops"):
            assert words in shown


async def test_the_advice_is_above_the_list_and_a_lost_leader_is_said_there() -> None:
    rig = FakeRig(5)
    rig.different["advice"] = "cam02 is aligning: wait a few seconds."
    app = make_app(rig)
    async with running(app) as pilot:
        assert text(app, "#advice").strip() == "◑ cam02 is aligning: wait a few seconds."
        rig.lose_link("192.168.1.5:47010 does not answer; trying again")
        await settle(pilot)
        assert text(app, "#advice").startswith("✖ press l to restart it (192.168.1.5:47010 does not answer")


async def test_why_a_camera_failed_is_in_place_of_its_strip() -> None:
    rig = FakeRig(1)
    rig.nodes += (make_node("cam01", NodeState.FAILED, phase_error_ns=None, message="[b]too dark\x1b[2J"),)
    app = make_app(rig)
    async with running(app):
        assert "[b]too dark\\x1b[2J" in text(app, ROWS)
        assert "✖ failed" in text(app, ROWS)


async def test_cameras_below_a_relay_are_a_tree() -> None:
    rig = FakeRig(1)
    rig.nodes += (make_node("aaa", parent="cam00", depth=2, camera=make_facts(label="カメラ左")),)
    app = make_app(rig)
    async with running(app):
        first, second = (line for line in lines(app, ROWS) if "ready" in line)
        assert "cam00" in first
        assert "└ カメラ左" in second, "as its owner wrote"


async def test_keys_and_clicks_choose_a_camera_and_scroll_to_it() -> None:
    app = make_app(FakeRig(20))
    async with running(app) as pilot:
        rows = app.screen.query_one(CameraRows)

        def chosen() -> str:
            return rows.chosen

        assert chosen() == "cam00"
        await pilot.press("down", "j", "up")
        assert chosen() == "cam01"
        await pilot.press("end")
        await settle(pilot)
        assert chosen() == "cam19"
        assert rows.scroll_y > 0
        await pilot.press("home")
        await settle(pilot)
        await pilot.click(ROWS, offset=(5, 3))
        assert chosen() == "cam03"


async def test_a_lost_camera_is_removed_by_a_key_and_one_elsewhere_is_not() -> None:
    rig = FakeRig(5)
    app = make_app(rig)
    async with app.run_test(size=(120, 40), notifications=True) as pilot:
        await settle(pilot)
        await pilot.press("delete")
        await settle(pilot)
        assert toasts(app) == ["cam00 runs on another machine, 192.168.1.7:50112 (stop it there with Ctrl-C)"]
        await pilot.press("end", "delete")
        await settle(pilot)
        assert rig.asked == [("order", RemoveCamera(name="cam04"))]
        assert "cam04" not in text(app, ROWS)
        rig.change("cam03", state=NodeState.LOST)
        rig.failure = BadInputError("cam03 is back")
        await settle(pilot)
        await pilot.press("end", "delete")
        await settle(pilot)
        assert "cam03 is back" in toasts(app)
        assert "✖ cam03 is back" in text(app, "#log Lines")


async def test_news_have_times_and_keep_their_words(utc: None) -> None:
    rig = FakeRig(5)
    app = make_app(rig)
    async with running(app) as pilot:
        await pilot.press("2")  # what happens while another mode is shown is there afterwards
        rig.news("cam00 joined")
        rig.news("[red]lost cam04", level="warning")
        await settle(pilot)
        await pilot.press("1")
        await settle(pilot)
        assert lines(app, "#log Lines") == ("22:13:21 · cam00 joined", "22:13:22 ! [red]lost cam04")
        await pilot.press("L")
        assert app.focused is app.screen.query_one("#log")
        await pilot.press("L")
        assert isinstance(app.focused, CameraRows)
        await pilot.press("L", "escape")
        assert isinstance(app.focused, CameraRows)


async def test_the_newest_line_of_the_log_is_visible_after_another_mode() -> None:
    rig = FakeRig(2)
    app = make_app(rig)
    async with app.run_test(size=(80, 24)) as pilot:
        rig.news("cam00 joined")
        await settle(pilot)
        await pilot.press("2")
        for number in range(8):
            rig.news(f"burst {number}: 16 of 16 images, saved as /home/ada/sessions/a-long-name-{number}")
        await settle(pilot)
        await pilot.press("1")
        rig.lose_link("192.168.1.5:47010 does not answer")
        await settle(pilot)
        log = app.screen.query_one("#log")
        assert 0 < log.scroll_y == log.max_scroll_y
        await pilot.press("L", "up", "up")
        await settle(pilot)
        rig.news("one more, while one reads an old one")
        await settle(pilot)
        assert log.scroll_y < log.max_scroll_y - 1
        await pilot.press("L")
        rig.news("and one when the log is left")
        await settle(pilot)
        assert log.scroll_y == log.max_scroll_y


async def test_a_phase_that_comes_home_is_a_trace_into_the_band() -> None:
    rig = FakeRig(1)
    now = [100.0]
    app = make_app(rig, record=RigRecord(lambda: now[0]))
    async with app.run_test(size=(80, 24)) as pilot:
        for error in (9_000_000, 3_000_000, 800_000, 90_000, 4_000):
            rig.change("cam00", phase_error_ns=error)
            now[0] += 2.0
            await settle(pilot)
        rig.change("cam00", state=NodeState.ALIGNING)
        await settle(pilot)
        above, band = lines(app, ROWS)[:3], lines(app, ROWS)[3:6]
        assert any("▁" in line or "▔" in line for line in above)
        assert any("─" in line or "▔" in line for line in band)


async def test_only_what_concerns_the_list_is_offered_with_the_news_and_own_disks_are_told_once() -> None:
    rig = FakeRig(1)
    rig.nodes += (make_node("own", on_leader=True),)
    rig.different["advice"] = "cam00: " + "this sentence goes on and on " * 9
    app = make_app(rig)
    async with running(app) as pilot:
        assert text(app, ROWS).count("34 GB free") == 1
        seen = app.export_screenshot().replace("&#160;", " ")
        assert "…" in seen, "a sentence that is cut says so"
        assert "Remove" in text(app, "#footer")
        await pilot.press("L")
        await settle(pilot)
        assert "Remove" not in text(app, "#footer")


async def test_a_code_for_another_machine_is_large_wherever_one_looks_at_the_rig() -> None:
    rig = FakeRig(2)
    app = make_app(rig)
    async with running(app, 100, 30) as pilot:
        await pilot.press("i")
        await settle(pilot)
        shown = lines(app, "#invite-words")
        assert set(large("1234 5678")) <= set(shown)
        assert any("--leader" in line for line in shown)
        await pilot.press("i")
        await settle(pilot)
        assert rig.asked == [("ask", Invite())] * 2


async def test_cameras_are_staggered_by_a_key_and_the_header_says_so() -> None:
    rig = FakeRig(2)
    app = make_app(rig)
    async with running(app, 100, 30) as pilot:
        assert "stagger" not in text(app, "#header")
        await pilot.press("T")
        await settle(pilot)
        await pilot.press("enter")
        await settle(pilot)
        assert rig.asked == [("order", StaggerCameras(order="even"))]
        rig.different |= {"stagger": "even", "steps": "steps of 16.7 ms"}
        rig.tell()
        await settle(pilot)
        assert "stagger: even, steps of 16.7 ms" in text(app, "#header")
        await pilot.press("T")
        await settle(pilot)
        await pilot.press(*["backspace"] * 4, *"odd", "enter")
        await settle(pilot)
        assert not rig.asked[1:], "it is no order: the question stays"
        await pilot.press(*["backspace"] * 3, *"off", "enter")
        await settle(pilot)
        assert rig.asked[1:] == [("order", StaggerCameras(order=""))]


async def test_of_a_leader_that_is_gone_one_thing_is_said() -> None:
    rig = FakeRig(2)
    app = make_app(rig)
    async with running(app, 100, 30) as pilot:
        rig.lose_link("no leader at 192.168.1.5:47010")
        await settle(pilot)
        assert "no leader at" in text(app, "#advice")
        assert "ready" not in text(app, "#cameras-rows") + text(app, "#advice")


@pytest.mark.parametrize("cameras", [0, 2])
async def test_a_leader_of_this_machine_that_is_gone_is_started_again_by_a_key(
    cameras: int, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    started: list[dict[str, object]] = []
    answers = asyncio.Event()

    async def start(**how: object) -> None:
        started.append(how)
        await answers.wait()

    monkeypatch.setattr("capture_app.tui.rig.rig_view.start_rig", start)
    rig = FakeRig(cameras)
    app = make_app(rig, sessions=tmp_path)
    async with running(app) as pilot:
        await pilot.press("l")
        await settle(pilot)
        assert not started, "nothing is lost"
        rig.lose_link("no leader at 127.0.0.1:47010")
        await settle(pilot)
        assert "press l to restart it" in text(app, "#advice")
        assert "l Restart leader" in text(app, "#footer")
        await pilot.press("l")
        await settle(pilot)
        assert started == [{"sessions": tmp_path, "host": "0.0.0.0", "port": 47010, "stagger": None}]
        assert "starting a leader at 127.0.0.1:47010" in text(app, "#advice")
        answers.set()
        await settle(pilot)
        assert "runs again, connecting" in text(app, "#advice")
        assert "press l" not in text(app, "#advice")
        rig.tell()
        await settle(pilot)
        assert "Restart leader" not in text(app, "#footer")


async def test_cameras_of_this_machine_come_back_with_a_restarted_leader(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Only simulated ones did, and with other names if cameras of the scene had been removed."""

    async def start(**_: object) -> None:
        pass

    monkeypatch.setattr("capture_app.tui.rig.rig_view.start_rig", start)
    rig = FakeRig(0)
    specs = {"cam03": "sim:phone-a,view=cam03", "left": "v4l2:/dev/video0", "far": ""}
    rig.nodes = tuple(make_node(name, on_leader=bool(spec), spec=spec) for name, spec in specs.items())
    app = make_app(rig, sessions=tmp_path)
    async with running(app) as pilot:
        rig.lose_link("no leader at 127.0.0.1:47010")
        await settle(pilot)
        await pilot.press("l")
        await settle(pilot)
        assert [order for kind, order in rig.asked if kind == "order"] == [
            AddCamera(spec=specs[name], name=name) for name in ("cam03", "left")
        ]


async def test_the_list_says_whether_cameras_are_exposed_alike() -> None:
    rig = FakeRig(0)
    rig.nodes = (*map(make_node, ("cam0", "cam1", "cam2")), make_node("gone", NodeState.LOST, gain=9.0))
    app = make_app(rig)
    async with running(app, 100, 30) as pilot:
        assert str(app.screen.query_one(CameraList).border_title) == "4 cameras · 1/100 s, gain 1.5"
        rig.change("cam1", exposure_ns=10_010_000)
        await settle(pilot)
        assert "different" not in str(app.screen.query_one(CameraList).border_title), "rounded"
        rig.change("cam1", gain=4.0, message="x")
        await settle(pilot)
        assert str(app.screen.query_one(CameraList).border_title) == "4 cameras · different gain"


async def test_a_leader_elsewhere_is_not_started_from_here() -> None:
    rig = FakeRig(2)
    app = make_app(rig, local=False)
    async with app.run_test(size=(150, 30)) as pilot:
        rig.lose_link("no leader at 192.168.1.5:47010")
        await settle(pilot)
        assert "Restart leader" not in text(app, "#footer")
