"""Help, palette, changed keys, and leaving."""

import asyncio
import re
from pathlib import Path

import msgspec
import pytest
from textual.command import Command, CommandList, CommandPalette
from textual.dom import DOMNode
from textual.widgets import Input, Static

from capture_app.common.errors import NetworkError
from capture_app.protocol.orders import EndBurst, StopRig
from capture_app.protocol.status import BurstStatus
from capture_app.rig.process import recorded_rig
from capture_app.tui import app as app_module
from capture_app.tui.app import POLL_S, SimulshotApp
from capture_app.tui.jobs.run import COMMANDS
from capture_app.tui.key_bindings import HelpScreen, keys_file_text, known_actions, unknown_names
from capture_app.tui.library.session_rows import SessionRows
from capture_app.tui.palette import Palette
from capture_app.tui.question import Question, TextQuestion
from capture_app.tui.rig.camera_screen import CameraScreen
from capture_app.tui.screen_settings import Settings
from tests.project import ROOT
from tests.unit.tui.driving import make_app, running, screen_of, settle, text, toasts, until
from tests.unit.tui.fake_rig import FakeRig, make_node
from tests.unit.tui.takes import make_take


def own_rig(cameras: int = 2) -> FakeRig:
    """A rig whose cameras are processes of the leader's."""
    rig = FakeRig(0)
    rig.nodes = tuple(make_node(f"cam{n:02d}", on_leader=True) for n in range(cameras))
    return rig


async def test_help_lists_the_keys_of_where_it_is_asked_for() -> None:
    app = make_app(FakeRig(5))
    async with running(app) as pilot:
        await pilot.press("question_mark")
        await settle(pilot)
        shown = text(app, "#help-keys")
        for words in ("del ", "Remove", "remove a lost one", "everywhere", "asks first"):
            assert words in shown
        await pilot.press("end")
        await settle(pilot)
        last = app.export_screenshot().replace("&#160;", " ").replace("&#x27;", "'")
        for words in (
            "saved as a session's folder",
            "enter on a camera, then X",
            "then reconstruct calibrate",
        ):
            assert words in last, "it is scrolled to, and not cut"
        await pilot.press("escape")
        assert not isinstance(app.screen, HelpScreen)
        await pilot.press("4", "question_mark")
        await settle(pilot)
        assert "remove a lost one" not in text(app, "#help-keys")


@pytest.mark.parametrize("local", [True, False])
async def test_help_says_where_the_log_of_a_rig_on_this_machine_is(tmp_path: Path, local: bool) -> None:
    rig, log = FakeRig(1), tmp_path / "1.log"
    app = make_app(rig, local=local)
    with recorded_rig(rig.leader, tmp_path, log):
        async with running(app) as pilot:
            await pilot.press("question_mark")
            await settle(pilot)
            foot = str(app.screen.query_one("#help-foot", Static).content)
            assert (f"The rig's log: {log}" in foot) == local


async def test_the_palette_does_what_a_key_does() -> None:
    app = make_app(FakeRig(5))
    async with running(app) as pilot:
        await pilot.press("ctrl+p")
        palette = screen_of(app, CommandPalette)
        await pilot.press(*"add cameras")
        found = palette.query_one(CommandList)
        await until(
            pilot,
            lambda: [one.hit.text for one in found.options if isinstance(one, Command)] == ["Add cameras"],
        )
        await pilot.press("down", "enter")
        await settle(pilot)
        assert app.screen.query_one("#start").display


@pytest.mark.parametrize(
    ("typed", "title"),
    [
        ("delete", "Trash"),
        ("remove", "Trash"),
        ("blender", "Export to splats"),
        ("premiere", "Export to otio"),
        ("davinci", "Export to otio"),
        ("resolve", "Export to otio"),
        ("mocap", "People"),
        ("skeleton", "People"),
        ("point cloud", "Depth from all cameras"),
        ("mesh", "Depth from all cameras"),
        ("webcam", "Add cameras"),
        ("dark", "Theme"),
        ("frame rate", "Frames a second"),
        ("iso", "Exposure"),
        ("two takes", "Sort"),
        ("disk", "Empty the trash"),
        ("size", "Look"),
        ("kill", "Remove"),
        ("IP cameras", "IP cameras"),
        ("onvif", "IP cameras"),
        ("OSC", "Joints as OSC or LSL"),
        ("charuco", "Print a board"),
        ("12", "Add cameras"),
        ("12 cam", "Add cameras"),
    ],
)
async def test_the_palette_finds_an_action_by_the_words_of_other_programs(typed: str, title: str) -> None:
    app = make_app(FakeRig(1))
    async with running(app):
        found = [str(hit.text) async for hit in Palette(app.screen).search(typed)]
        assert any(one.startswith(title) for one in found), found


async def test_a_known_word_comes_before_letters_scattered_over_a_title() -> None:
    app = make_app(FakeRig(1))
    async with running(app):
        hits = sorted([hit async for hit in Palette(app.screen).search("pose")], reverse=True)
        assert [str(hit.text) for hit in hits[:2]] == ["People", "Export to pose2sim"]


@pytest.mark.parametrize(
    ("typed", "first"), [("davinci", "Export to otio"), ("light", "Theme simulshot-light")]
)
async def test_the_choice_that_is_meant_comes_before_its_action(typed: str, first: str) -> None:
    app = make_app(FakeRig(1))
    async with running(app):
        hits = sorted([hit async for hit in Palette(app.screen).search(typed)], reverse=True)
        assert str(hits[0].text) == first


async def test_the_palette_runs_an_analysis_and_an_export_of_the_selected_session(tmp_path: Path) -> None:
    make_take(tmp_path, name="one")
    app = make_app(FakeRig(1), sessions=tmp_path)
    async with running(app) as pilot:
        await pilot.press("3")
        await until(pilot, lambda: app.screen.query(SessionRows) and app.screen.query_one(SessionRows).keys)
        for title, question in (("People", "OPTIONS"), ("Export to mp4", "mp4")):
            (action,) = [one for one in app.get_system_commands(app.screen) if one.title == title]
            await action.callback()
            await until(pilot, lambda: isinstance(app.screen, TextQuestion))
            shown = [str(one.content) for one in app.screen.query(Static)]
            assert question in " ".join([*shown, app.screen.query_one(Input).value])
            await pilot.press("escape")
            await settle(pilot)


async def test_an_analysis_of_no_session_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    monkeypatch.setattr(app_module, "find_samples", lambda _: None)
    app = make_app(FakeRig(1), sessions=tmp_path)
    async with running(app):
        (action,) = [one for one in app.get_system_commands(app.screen) if one.title == "People"]
        monkeypatch.setattr(app, "notify", said.append)
        await action.callback()
        assert "is selected in Sessions" in "".join(said)


async def test_the_palette_knows_the_actions_of_all_modes() -> None:
    app = make_app(FakeRig(5))
    async with running(app) as pilot:
        offered = {command.title: command for command in app.get_system_commands(app.screen)}
        for word, where in (("calib", "in Sessions, key A"), ("delete it", "in Sessions, key del")):
            (found,) = [command for title, command in offered.items() if word in title]
            assert found.help == where
        assert any("expos" in title.casefold() for title in offered)
        assert offered["Take"].help == "in Shoot, key space"
        await offered["Name"].callback()
        await settle(pilot)
        assert app.current_mode in ("shoot", "sessions")


async def test_the_key_of_a_mode_shows_the_mode_and_not_what_was_open_in_it() -> None:
    app = make_app(FakeRig(3))
    async with running(app, 100, 30) as pilot:
        await pilot.press("enter")
        await settle(pilot)
        assert isinstance(app.screen, CameraScreen)
        await pilot.press("2", "1")
        await settle(pilot)
        assert app.current_mode == "rig"
        assert "rig.add" in {each.binding.id for each in app.active_bindings.values()}


def test_every_action_has_a_name_and_words() -> None:
    assert {"app.quit", "rig.remove", "start.simulate"} <= set(known_actions())
    assert all(action.description and action.key for action in known_actions().values())


def test_a_letter_means_the_same_on_every_screen() -> None:
    meanings: dict[str, set[str]] = {}
    for action in known_actions().values():
        for key in action.key.split(","):
            # Other keys move, open and close what is on the screen; lists also move by j and k.
            if len(key) == 1 and key not in "jk" and key.isalpha():
                meanings.setdefault(key, set()).add(action.description)
    assert len(meanings) > 25
    assert {key: labels for key, labels in meanings.items() if len(labels) > 1} == {}


def test_every_key_has_an_action_that_exists() -> None:
    known_actions()  # imports all screens
    kinds, missing = [DOMNode], []
    while kinds:
        kind = kinds.pop()
        kinds += kind.__subclasses__()
        if kind.__module__.startswith("capture_app."):
            for binding in kind.__dict__.get("BINDINGS", ()):
                action, _, parameter = binding.action.partition("(")
                what = parameter.strip("')")
                is_method = action == "on_session" and what not in COMMANDS
                method = f"_{what}" if is_method else f"action_{action}"
                if "." not in action and not hasattr(kind, method):
                    missing.append(f"{kind.__name__}.{method}")
    assert not missing


async def test_keys_are_changed_in_a_file_that_help_writes(tmp_path: Path) -> None:
    app = make_app(FakeRig(5), settings=Settings.load(tmp_path))
    async with app.run_test(size=(80, 24), notifications=True) as pilot:
        await settle(pilot)
        for _ in range(2):  # the second time it exists already, and stays
            await pilot.press("question_mark", "W")
            for worker in [worker for worker in app.workers if worker.group == "settings"]:
                await worker.wait()
            await settle(pilot)
        path = tmp_path / "keys.toml"
        assert path.read_text() == keys_file_text()
        assert any("exists already" in toast for toast in toasts(app))
    lines = path.read_text().splitlines()
    (line,) = (line for line in lines if "rig.log" in line)
    path.write_text(line.replace("# ", "", 1).replace('"L"', '"z"') + '\n"rig.dance" = "y"\n')
    app = make_app(FakeRig(5), settings=Settings.load(tmp_path))
    async with app.run_test(size=(80, 24), notifications=True) as pilot:
        await settle(pilot)
        assert toasts(app) == ["keys.toml names unknown actions: rig.dance; the help (?) lists all"]
        await pilot.press("z")
        assert app.focused is app.screen.query_one("#log")


@pytest.mark.parametrize(("key", "stopped"), [("l", False), ("s", True)])
async def test_a_rig_of_this_machine_is_left_or_stopped_as_the_user_says(key: str, stopped: bool) -> None:
    rig = own_rig()
    app = make_app(rig)
    async with running(app) as pilot:
        await pilot.press("q")
        await settle(pilot)
        assert isinstance(app.screen, Question)
        await pilot.press("n")  # stay
        await settle(pilot)
        assert app.is_running
        assert not rig.asked
        await pilot.press("q", key)
        await settle(pilot)
    assert rig.asked == ([("order", StopRig())] if stopped else [])
    assert app.return_code == 0


async def test_a_rig_that_takes_its_time_to_stop_is_said_to_be_stopping(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rig, stopped = own_rig(), asyncio.Event()

    async def order(_: object) -> None:
        await stopped.wait()

    monkeypatch.setattr(rig, "order", order)
    app = make_app(rig)
    async with app.run_test(size=(80, 24), notifications=True) as pilot:
        await settle(pilot)
        await pilot.press("q", "s")
        await settle(pilot)
        assert toasts(app) == ["Stopping the rig …"]
        stopped.set()
        await settle(pilot)
    assert app.return_code == 0


async def leaves_at_once(app: SimulshotApp) -> bool:
    async with running(app) as pilot:
        await pilot.press("q")
        await settle(pilot)
        return not isinstance(app.screen, Question)


async def test_nothing_is_asked_where_nothing_is_lost() -> None:
    elsewhere = own_rig()
    assert await leaves_at_once(make_app(elsewhere, local=False))
    assert await leaves_at_once(make_app(FakeRig(5)))  # cameras of other machines, a rig that was there
    assert not await leaves_at_once(make_app(FakeRig(5), started=True))
    empty = FakeRig(0)
    assert await leaves_at_once(make_app(empty, started=True))
    assert empty.asked == [("order", StopRig())]
    assert not elsewhere.asked


async def test_a_burst_under_way_is_spoken_of_and_a_rig_that_will_not_stop_too() -> None:
    rig = own_rig()
    rig.burst_status = BurstStatus(burst=1, name="burst-001", cameras=2, instants=5, received=3, expected=10)
    app = make_app(rig)
    async with running(app) as pilot:
        await pilot.press("q")
        await settle(pilot)
        question = str(app.screen.query_one(".question").render())
        assert "burst-001 is being saved: 3 of 10 images are here." in question
        assert "--stop" not in question
        rig.failure = NetworkError("the leader does not answer")
        await pilot.press("s")
        await settle(pilot)
    assert app.return_code == 0
    assert rig.asked == [("order", StopRig())]


async def test_a_recording_is_ended_and_saved_before_the_rig_is_stopped() -> None:
    """That is the first answer, so that an Enter too many loses nothing; to stay takes it back."""
    rig = own_rig()
    recording = BurstStatus(
        burst=1, name="recording-001", cameras=2, instants=510, received=85, expected=1020, recording=True
    )
    rig.burst_status = recording
    app = make_app(rig)
    async with app.run_test(size=(80, 24)) as pilot:
        await settle(pilot)
        await pilot.press("q")
        question = str(app.screen.query_one(".question").render())
        assert "recording-001 is recording: 85 of 1020 images are here." in question
        assert "`capture-app record --stop` ends the recording" in " ".join(question.split())
        await pilot.press("enter")
        await settle(pilot)
        assert rig.asked == [("order", EndBurst(burst=1))]
        assert app.is_running
        rig.tell()
        await until(pilot, lambda: "stops when saved" in text(app, "#header"))
        await pilot.press("q", "n")
        rig.tell()
        await until(pilot, lambda: "stops when saved" not in text(app, "#header"))
        await pilot.press("q", "f")
        rig.burst_status = msgspec.structs.replace(recording, received=1020, done=True)
        rig.tell()
        await until(pilot, lambda: app.return_code is not None)
    assert rig.asked == [("order", EndBurst(burst=1)), ("order", EndBurst(burst=1)), ("order", StopRig())]


async def test_a_take_that_is_no_recording_is_not_ended_and_a_lost_link_stops_no_rig() -> None:
    rig = own_rig()
    lapse = BurstStatus(burst=1, name="lapse-001", cameras=2, instants=360, received=8, expected=720)
    rig.burst_status = lapse
    app = make_app(rig)
    async with app.run_test(size=(80, 24)) as pilot:
        await settle(pilot)
        await pilot.press("q", "f")
        await settle(pilot)
        rig.lose_link()
        await settle(pilot)
        await asyncio.sleep(2 * POLL_S)
        assert not rig.asked
        rig.burst_status = msgspec.structs.replace(lapse, received=720, done=True)
        rig.tell()
        await until(pilot, lambda: app.return_code is not None)
    assert rig.asked == [("order", StopRig())]


async def test_leaving_twice_needs_no_answer() -> None:
    rig = own_rig()
    app = make_app(rig)
    async with running(app) as pilot:
        await pilot.press("ctrl+q")
        await settle(pilot)
        await pilot.press("ctrl+q")
        await settle(pilot)
    assert app.return_code == 0
    assert not rig.asked


def test_the_page_names_actions_that_exist() -> None:
    page = (ROOT / "docs" / "terminal-ui.md").read_text()
    named = set(re.findall(r'^    "([\w.-]+)" = ', page, re.MULTILINE))
    assert named
    assert unknown_names(named) == []


async def test_an_earlier_take_is_ended_and_saved_too_before_the_rig_is_stopped() -> None:
    """What was still arriving of it was cut off when the newest take was saved."""
    rig = own_rig()
    earlier = BurstStatus(
        burst=1, name="recording-001", cameras=2, instants=9, received=5, expected=18, recording=True
    )
    rig.burst_status = BurstStatus(
        burst=2, name="burst-001", cameras=2, instants=1, received=2, expected=2, done=True
    )
    rig.different = {"unsaved": (earlier,)}
    app = make_app(rig)
    async with app.run_test(size=(80, 24)) as pilot:
        await settle(pilot)
        await pilot.press("q")
        question = str(app.screen.query_one(".question").render())
        assert "recording-001 is recording: 5 of 18 images are here." in question
        await pilot.press("f")
        await settle(pilot)
        await asyncio.sleep(2 * POLL_S)
        assert rig.asked == [("order", EndBurst(burst=1))]
        rig.different = {}
        rig.tell()
        await until(pilot, lambda: app.return_code is not None)
    assert rig.asked[1:] == [("order", StopRig())]
