"""The first minute: every choice by its key, on a rig without a camera."""

from pathlib import Path

import pytest
from textual.widgets import OptionList

from capture_app.common.camera_facts import CameraListing
from capture_app.common.errors import CameraError, UnknownMachineError
from capture_app.plugins.cameras.v4l2 import v4l2_driver
from capture_app.protocol.orders import AddCamera, AddSimulated
from capture_app.protocol.pairing_messages import Invite
from capture_app.tui.app import SimulshotApp
from capture_app.tui.rig.guide_screens import joining_line, qr_lines
from capture_app.tui.rig.start import QUICK, StartPanel
from capture_app.tui.screen_settings import Settings
from tests.unit.tui.driving import lines, make_app, settle, text, toasts
from tests.unit.tui.fake_rig import FakeRig

WEBCAM = CameraListing("v4l2:/dev/video0", "v4l2", "[b]Webcam", "MJPG 1280x720 at 30 frames/s")
BUSY = CameraListing("v4l2:/dev/video2", "v4l2", "Other", "in use", usable=False)


@pytest.fixture(autouse=True)
def cameras(monkeypatch: pytest.MonkeyPatch) -> list[CameraListing]:
    """The cameras of this machine."""
    found: list[CameraListing] = []
    monkeypatch.setattr(v4l2_driver, "list_cameras", lambda: found)
    return found


def offered(app: SimulshotApp) -> list[str]:
    return [str(option.prompt).strip() for option in app.screen.query_one(OptionList).options]


async def rest(app: SimulshotApp, pilot: object) -> None:
    """Until the machine has been looked at."""
    for worker in [worker for worker in app.workers if worker.group == "offers"]:
        await worker.wait()
    await settle(pilot)


async def test_what_is_there_is_offered_and_told(cameras: list[CameraListing], tmp_path: Path) -> None:
    cameras += [WEBCAM, BUSY]
    (tmp_path / "burst-001").mkdir()
    (tmp_path / "burst-001" / "session.json").write_text("{}")
    app = make_app(FakeRig(0), sessions=tmp_path)
    async with app.run_test(size=(80, 24)) as pilot:
        await rest(app, pilot)
        assert offered(app) == [
            "c  [b]Webcam video0",
            "e  Other video2",
            "i  Invite other machines",
            "h  Phones by a QR code",
            "s  Try 5 simulated cameras",
            "O  Open 1 session",
            "S  Browse the samples",
        ]
        assert "MJPG 1280x720" in text(app, "#start-meaning")
        assert joining_line("192.168.1.5:47010") in text(app, "#start-line")


async def test_what_needs_no_camera_comes_first_where_there_is_none() -> None:
    app = make_app(FakeRig(0))
    async with app.run_test(size=(80, 24)) as pilot:
        await rest(app, pilot)
        assert offered(app)[0] == "s  Try 5 simulated cameras"


async def test_a_camera_is_one_key_away_and_is_the_first_choice_next_time(
    cameras: list[CameraListing], tmp_path: Path
) -> None:
    cameras += [WEBCAM, BUSY]
    rig, settings = FakeRig(0), Settings(tmp_path)
    app = make_app(rig, settings=settings)
    async with app.run_test(size=(80, 24)) as pilot:
        await rest(app, pilot)
        await pilot.press("e", "c")  # e is in use
        await settle(pilot)
        assert rig.asked == [("order", AddCamera(spec="v4l2:/dev/video0"))]
    settings.remember("start.choice", "simulated")
    settings.save()
    app = make_app(FakeRig(0), settings=Settings.load(tmp_path))
    async with app.run_test(size=(80, 24)) as pilot:
        await rest(app, pilot)
        assert offered(app)[0] == "s  Try 5 simulated cameras  last time"


async def test_simulated_cameras_as_many_as_wanted_then_the_rig_is_shown() -> None:
    rig, settings = FakeRig(0), Settings()
    app = make_app(rig, settings=settings)
    async with app.run_test(size=(80, 24)) as pilot:
        await rest(app, pilot)
        await pilot.press("+", "+", "+", "-", "N")
        assert "pinwheel" in text(app, "#start-meaning")
        assert "s  Try 5 simulated cameras" in offered(app)  # that scene has no more views
        await pilot.press("-", "s")
        await settle(pilot)
        assert rig.asked == [("order", AddSimulated(cameras=4, scene="pinwheel", options=QUICK))]
        assert "◔ syncing" in text(app, "#cameras-rows")
        assert not app.screen.query_one("#start").display
        await pilot.press("a")  # more of them, and back
        assert app.screen.query_one("#start").display
        await pilot.press("escape")
        assert not app.screen.query_one("#start").display
        await pilot.press("a", "2", "1")
        await settle(pilot)
        assert app.screen.query_one("#start").display, "another mode leaves it as it is"
        await pilot.press("1")
        await settle(pilot)
        assert not app.screen.query_one("#start").display


async def test_a_scene_for_more_cameras_is_named_where_one_has_no_more_views() -> None:
    app = make_app(FakeRig(0))
    async with app.run_test(size=(60, 20), notifications=True) as pilot:
        await rest(app, pilot)
        await pilot.press(*"++")
        assert "“bars” has 64" in " ".join(lines(app, "#start-meaning"))
        assert not toasts(app)
        await pilot.press("+")
        await settle(pilot)
        assert toasts(app) == ["“studio” has no more views; N: the scene. “bars” has 64"]
        await pilot.press(*"NNNN", "+")
        await settle(pilot)
        assert "s  Try 8 simulated cameras" in offered(app)
        assert " ".join(lines(app, "#start-line")).endswith("--camera v4l2:/dev/video0"), "none of it is cut"
        assert max(map(len, lines(app, "#start-line"))) <= app.screen.query_one("#start-line").size.width


async def test_what_cannot_be_started_is_said_in_a_sentence(cameras: list[CameraListing]) -> None:
    cameras.append(WEBCAM)
    rig = FakeRig(0)
    app = make_app(rig)
    async with app.run_test(size=(80, 24), notifications=True) as pilot:
        await rest(app, pilot)
        rig.failure = CameraError("/dev/video0 is in use", hint="close the other program")
        await pilot.press("enter")
        await settle(pilot)
        assert toasts(app) == ["/dev/video0 is in use (close the other program)"]
        assert "/dev/video0 is in use" in text(app, "#start-meaning"), "it stays after the message is gone"


async def test_inviting_shows_the_line_and_its_code() -> None:
    app = make_app(FakeRig(0))
    async with app.run_test(size=(80, 24)) as pilot:
        await rest(app, pilot)
        await pilot.press("i")
        await settle(pilot)
        code = app.screen.query_one("#invite-code")
        assert lines(app, "#invite-code") == tuple(
            line.plain for line in qr_lines(joining_line("192.168.1.5:47010"))
        )
        # All of it is seen: half a code is none.
        assert code.region.height == 19
        assert app.screen.region.contains_region(code.region)


async def test_inviting_shows_a_number_for_machines_that_are_not_known() -> None:
    rig = FakeRig(0)
    app = make_app(rig)
    async with app.run_test(size=(80, 24)) as pilot:
        await rest(app, pilot)
        await pilot.press("i")
        await settle(pilot)
        assert rig.asked == [("ask", Invite())]
        assert "1234 5678" in " ".join(text(app, "#invite-words").split())
        rig.failure = UnknownMachineError("this rig is open: any machine may join without a code")
        await pilot.press("i")
        await settle(pilot)
        assert "without a code" in " ".join(text(app, "#invite-words").split()).lower()


async def test_no_word_of_the_start_is_cut_in_a_narrow_terminal() -> None:
    rig = FakeRig(0)
    rig.different = {"leader": "192.168.100.200:33417"}
    app = make_app(rig)
    async with app.run_test(size=(80, 24)) as pilot:
        await rest(app, pilot)
        busy = "Starting 5 simulated cameras … Cameras join within half a minute."
        app.screen.query_one(StartPanel).say_busy(busy)
        assert " ".join(lines(app, "#start-meaning")) == busy
        await pilot.press("i")
        await settle(pilot)
        words = app.screen.query_one("#invite-words")
        assert max(map(len, lines(app, "#invite-words"))) <= words.size.width
        await pilot.press("escape")
        await settle(pilot)
        for part in ("#start-meaning", "#start-line"):
            shown = lines(app, part)
            assert max(map(len, shown)) <= app.screen.query_one(part).size.width, shown


async def test_an_invitation_says_who_came_and_who_was_refused_since() -> None:
    rig = FakeRig(0)
    app = make_app(rig)
    async with app.run_test(size=(80, 24)) as pilot:
        await rest(app, pilot)
        rig.news("an old story")
        await pilot.press("i")
        await settle(pilot)
        assert lines(app, "#invite-news") == ()
        rig.news("a machine at 192.168.1.9 tried a wrong code", level="warning")
        rig.news("garage at 192.168.1.9 is now known as camera")
        await settle(pilot)
        seen = app.export_screenshot().replace("&#160;", " ")
        assert "192.168.1.9 tried a wrong code" in seen
        assert "is now known as camera" in seen
        code = app.screen.query_one("#invite-code")
        assert app.screen.region.contains_region(code.region), "the code stays whole"


async def test_sessions_and_samples_open_in_their_mode() -> None:
    app = make_app(FakeRig(0))
    async with app.run_test(size=(80, 24)) as pilot:
        await rest(app, pilot)
        await pilot.press("S")
        await settle(pilot)
        assert app.current_mode == "sessions"


async def test_cameras_here_are_not_offered_to_a_leader_elsewhere(cameras: list[CameraListing]) -> None:
    cameras.append(WEBCAM)
    app = make_app(FakeRig(0), local=False)
    async with app.run_test(size=(80, 24)) as pilot:
        await rest(app, pilot)
        assert not any("Webcam" in line for line in offered(app))


def test_a_code_is_what_was_put_in(tmp_path: Path) -> None:
    import cv2
    import numpy as np

    line = joining_line("192.168.1.5:47010")
    light = {"█": (1, 1), "▀": (1, 0), "▄": (0, 1), " ": (0, 0)}
    rows = [[light[character] for character in row.plain] for row in qr_lines(line)]
    modules = np.array([[cell[half] for cell in row] for row in rows for half in (0, 1)], np.uint8)
    picture = np.kron(modules[:37], np.ones((8, 8), np.uint8)) * 255
    picture = np.pad(picture, 32, constant_values=255)
    assert cv2.QRCodeDetector().detectAndDecode(picture)[0] == line


class SlowRig(FakeRig):
    """One whose cameras come later."""

    def add_cameras(self, cameras: int) -> None:
        """Start their processes."""


async def test_what_was_started_stays_said_until_it_is_there() -> None:
    """A process runs after 2 s, its camera is there after 22."""
    rig = SlowRig(0)
    app = make_app(rig)
    async with app.run_test(size=(100, 30)) as pilot:
        await rest(app, pilot)
        for press in ("s", "N"):
            await pilot.press(press)
            rig.tell()
            await settle(pilot)
            assert "Starting 5 simulated cameras" in text(app, "#start-meaning")
        FakeRig.add_cameras(rig, 5)
        await settle(pilot)
        assert not app.screen.query_one("#start").display
