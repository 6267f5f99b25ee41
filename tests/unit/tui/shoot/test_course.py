"""What Space does while the rig is not ready, or cannot save; and what the line below says of a take."""

import asyncio
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import pytest
from msgspec.structs import replace as replace_fields
from textual.geometry import Region
from textual.pilot import Pilot
from textual.widget import Widget
from textual.widgets import Button
from textual.widgets._toast import Toast

from capture_app.common.errors import BadInputError, DiskFullError, IncompleteError, NetworkError
from capture_app.common.node_state import NodeState
from capture_app.protocol.messages import BurstRequest
from capture_app.protocol.orders import CancelBurst, EndBurst
from capture_app.protocol.status import BurstStatus, CameraTransfer, RigStatus
from capture_app.rig.taking import TakePlan
from capture_app.tui.question import Question
from capture_app.tui.shoot.shoot_plan import TakeSettings, render_limit_s
from capture_app.tui.shoot.shoot_view import cancellable_bursts
from capture_app.tui.shoot.takes import Take, progress_words, transfer_line
from capture_app.tui.widgets.key_footer import KeyFooter
from capture_app.tui.widgets.lines import Lines
from tests.unit.tui.driving import toasts, until
from tests.unit.tui.fake_rig import FakeRig, make_node, show_motion
from tests.unit.tui.shoot.studio import Studio, ready_rig, saves_into
from tests.unit.tui.takes import make_take


def line_of(studio: Studio) -> str:
    return studio.view.query_one("#shoot-advice", Lines).plain[0]


def footer_of(studio: Studio) -> str:
    return studio.app.screen.query_one(KeyFooter).plain[0]


async def test_a_lost_camera_does_not_hold_the_take_up(tmp_path: Path) -> None:
    rig = ready_rig(2)
    rig.nodes = (*rig.nodes, make_node("cam09", NodeState.LOST))
    studio = Studio(rig, tmp_path)
    async with studio.running() as pilot:
        await pilot.press("space")
        await studio.settle(pilot)
        assert len(studio.requests) == 1


def waiting_rig() -> FakeRig:
    rig = ready_rig(2)
    rig.nodes = (rig.nodes[0], make_node("cam01", NodeState.ALIGNING, phase_error_ns=7_310_000))
    rig.different["advice"] = "cam01 is aligning"
    rig.is_ready = asyncio.Event()
    return rig


WAITING = "◔ Space takes now, esc cancels; waiting for the rig: cam01 is aligning"


async def test_space_while_a_camera_settles_takes_as_soon_as_all_are_ready(tmp_path: Path) -> None:
    rig = waiting_rig()
    rig.nodes = (*rig.nodes, make_node("cam09", NodeState.LOST))
    rig.take = saves_into(tmp_path, cameras=2)
    studio = Studio(rig, tmp_path)
    async with studio.running() as pilot:
        await pilot.press("space")
        await studio.settle(pilot)
        for _ in range(3):
            rig.tell()
            await studio.settle(pilot)
            assert line_of(studio) == WAITING
        assert not isinstance(studio.app.screen, Question)
        (request,) = studio.requests
        assert (request.wait_ready_s, request.nodes) == (120.0, 2), "the lost one is not waited for"
        assert rig.is_ready is not None
        rig.is_ready.set()
        await until(pilot, lambda: [take.status.name for take in studio.view.takes] == ["burst-001"])
        assert "waiting" not in line_of(studio)


async def test_space_again_takes_what_is_ready_at_once(tmp_path: Path) -> None:
    rig = waiting_rig()
    rig.take = saves_into(tmp_path, cameras=2)
    studio = Studio(rig, tmp_path)
    async with studio.running() as pilot:
        await pilot.press("space")
        await until(pilot, lambda: line_of(studio) == WAITING)
        await pilot.press("space")
        await until(pilot, lambda: studio.view.takes and studio.view.takes[0].status.done)
        assert [request.wait_ready_s for request in studio.requests] == [120.0, 0.0]
        assert len(studio.view.takes) == 1
        await pilot.press("space")
        await until(pilot, lambda: line_of(studio) == WAITING)
        assert studio.requests[2].wait_ready_s == 120.0, "the next take waits again"


def test_the_wait_looks_as_it_did(snap_compare: Any, tmp_path: Path) -> None:
    studio = Studio(waiting_rig(), tmp_path)

    async def before(pilot: Pilot[None]) -> None:
        await studio.enter(pilot)
        await pilot.press("space")
        await until(pilot, lambda: line_of(studio).startswith(WAITING[:50]))

    assert snap_compare(studio.app, terminal_size=(80, 24), run_before=before)


async def test_a_camera_that_corrects_a_drift_is_not_waited_for(tmp_path: Path) -> None:
    rig = FakeRig(2)
    rig.nodes = (rig.nodes[0], make_node("cam01", NodeState.ALIGNING, phase_error_ns=-110_000))
    rig.take = saves_into(tmp_path, cameras=2)
    studio = Studio(rig, tmp_path)
    async with studio.running() as pilot:
        await pilot.press("space")
        await until(pilot, lambda: [take.status.name for take in studio.view.takes] == ["burst-001"])
        assert studio.requests[0].wait_ready_s == 0


async def test_a_wait_that_is_given_up_says_why_and_one_is_cancelled_by_escape(tmp_path: Path) -> None:
    rig = waiting_rig()
    studio = Studio(rig, tmp_path)
    async with studio.running() as pilot:
        await pilot.press("space")
        await until(pilot, lambda: line_of(studio) == WAITING)
        assert rig.is_ready is not None
        rig.failure = IncompleteError("not ready after 120 s: cam01 is aligning", hint="look")
        rig.is_ready.set()
        await studio.settle(pilot)
        rig.tell()
        await studio.settle(pilot)
        assert line_of(studio) == "! no take: not ready after 120 s: cam01 is aligning"
        rig.is_ready.clear()
        await pilot.press("space")
        await until(pilot, lambda: line_of(studio) == WAITING)
        await pilot.press("escape")
        await studio.settle(pilot)
        assert line_of(studio) == "cam01 is aligning", "the rig's advice again"
        rig.is_ready.set()
        await studio.settle(pilot)
        assert studio.view.takes == []


async def test_a_take_that_failed_without_a_leader_is_forgotten_once_it_is_back(tmp_path: Path) -> None:
    rig = ready_rig(2)
    studio = Studio(rig, tmp_path)
    async with studio.running() as pilot:
        rig.lose_link()
        await studio.settle(pilot)
        rig.failure = NetworkError("no leader at 127.0.0.1:47010: Connect call failed", hint="start one")
        await pilot.press("space")
        await studio.settle(pilot)
        rig.failure = None
        rig.tell()
        await studio.settle(pilot)
        assert "no take" not in line_of(studio)
        assert "no leader" not in line_of(studio)


async def test_a_leader_elsewhere_has_the_session(tmp_path: Path) -> None:
    rig = ready_rig(2)

    async def take(request: BurstRequest) -> str:
        return "/home/ada/sessions/burst-001"

    rig.take = take
    studio = Studio(rig, tmp_path)
    async with studio.running(120, 40) as pilot:
        await pilot.press("space")
        await studio.settle(pilot)
        text = studio.view.take_panel.plain
        assert "saved on the leader's machine:\n/home/ada/sessions/burst-001\n16 of 16 images" in text
        assert "cam01    ██████████ 8/8 ✔" in text
        assert not studio.view.stage.is_sheet


async def test_an_order_that_fails_is_said(tmp_path: Path) -> None:
    rig = ready_rig(1)
    studio = Studio(rig, tmp_path)
    async with studio.running(notifications=True) as pilot:
        rig.failure = DiskFullError("the burst may need 90.0 MB and 1.0 MB are free", hint="make room")
        await pilot.press("space")
        await studio.settle(pilot)
        await studio.settle(pilot)
        assert "make room" in str(studio.app.screen.query_one(Toast).render())
        await pilot.press("space")
        await studio.settle(pilot)
        assert len(studio.requests) == 2


async def test_a_take_that_cannot_be_read_says_why(tmp_path: Path) -> None:
    rig = ready_rig(1)

    async def take(request: BurstRequest) -> str:
        (tmp_path / "burst-001").mkdir()
        (tmp_path / "burst-001" / "session.json").write_text("{}")
        return str(tmp_path / "burst-001")

    rig.take = take
    studio = Studio(rig, tmp_path)
    async with studio.running() as pilot:
        await pilot.press("space")
        await studio.settle(pilot)
        assert "✖ the take cannot be shown" in studio.view.take_panel.plain


async def test_bursts_ahead_are_cancelled_by_a_key(tmp_path: Path) -> None:
    rig = ready_rig(2)
    minute_ns = 60_000_000_000
    later = BurstStatus(burst=8, name="burst-008", cameras=2, instants=5, received=0, expected=10)
    later = replace_fields(later, first_leader_ns=9 * minute_ns)
    soon = replace_fields(later, burst=7, name="burst-007", instants=1, first_leader_ns=2 * minute_ns)
    rig.different["ahead"] = (later, soon)
    studio = Studio(rig, tmp_path)
    async with studio.running() as pilot:
        await pilot.press("x")
        await studio.settle(pilot)
        buttons = [str(button.label) for button in studio.app.screen.query(Button)]
        assert buttons == [
            "1 burst-007: begins in 2 min, 1 frame",
            "2 burst-008: begins in 9 min, 5 frames",
            "esc Keep all",
        ]
        await pilot.press("escape", "x", "2")
        await studio.settle(pilot)
        assert [asked[1] for asked in rig.asked if asked[0] == "order"] == [CancelBurst(burst=8)]


async def test_a_burst_that_is_being_saved_is_cancelled_too_and_a_refusal_is_told(tmp_path: Path) -> None:
    rig = ready_rig(2)
    rig.take, rig.saves = saves_into(tmp_path, cameras=2), asyncio.Event()
    studio = Studio(rig, tmp_path)
    async with studio.running(notifications=True) as pilot:
        await pilot.press("x")
        await until(pilot, lambda: any("no take is scheduled" in said for said in toasts(studio.app)))
        await pilot.press("space")
        await until(pilot, lambda: line_of(studio) == "◔ burst-001: taken; cameras are saving; x cancels")
        await pilot.press("x")
        await until(pilot, lambda: studio.app.screen.query(Button))
        first = studio.app.screen.query(Button).first()
        assert str(first.label).startswith("1 burst-001: 0 of ")
        rig.failure = BadInputError(
            "burst 1 is not under way", hint="capture-app sessions list shows saved ones"
        )
        await pilot.press("1")
        await until(pilot, lambda: any("not under way" in said for said in toasts(studio.app)))
        assert ("order", CancelBurst(burst=1)) in rig.asked
        rig.saves.set()
        await studio.settle(pilot)


def test_a_recording_in_the_way_of_a_newer_take_can_be_cancelled() -> None:
    walk = BurstStatus(
        burst=1, name="walk", recording=True, cameras=2, instants=90, received=7, expected=180, ended=True
    )
    newest = BurstStatus(burst=2, name="burst-001", cameras=2, instants=8, received=0, expected=16)
    takes = [Take(walk, TakePlan(video=True)), Take(newest, TakePlan())]
    status = RigStatus(leader="a:1", now_ns=0, period_ns=None, burst=newest)
    assert cancellable_bursts(status, takes) == {
        1: "walk: 7 of 180 images received",
        2: "burst-001: 0 of 16 images received",
    }
    takes[0].problem = "the leader was lost"
    assert list(cancellable_bursts(status, takes)) == [2], "another leader's burst has that number"
    takes[0] = Take(replace_fields(walk, done=True), TakePlan(video=True))
    assert list(cancellable_bursts(status, takes)) == [2]


async def test_simulated_cameras_record_no_more_than_they_render_in_minutes(tmp_path: Path) -> None:
    rig = ready_rig(5)
    spec = "sim:phone-a,scene={},drops=0"
    rig.nodes = tuple(replace_fields(node, spec=spec.format("studio")) for node in rig.nodes)
    studio = Studio(rig, tmp_path)
    async with studio.running(120, 40) as pilot:
        panel = studio.view.plan_panel
        panel.change(replace(panel.settings, mode="recording", seconds=300.0))
        rig.tell()
        await studio.settle(pilot)
        assert "simulated cameras ends after 10 s" in line_of(studio)
        await pilot.press("space")
        await studio.settle(pilot)
        assert [request.seconds for request in studio.requests] == [10.0]
    rig.nodes = tuple(replace_fields(node, spec=spec.format("bars")) for node in rig.nodes)
    assert render_limit_s(rig.status()) is None, "a test card is drawn as fast as it is recorded"
    rig.nodes = ready_rig(5).nodes
    assert render_limit_s(rig.status()) is None, "a scene may be rendered by another machine"


async def test_space_records_and_ends_the_recording(tmp_path: Path) -> None:
    rig = ready_rig(2)
    studio = Studio(rig, tmp_path)
    async with studio.running(120, 40) as pilot:
        plan = replace(studio.view.plan_panel.settings, mode="recording", seconds=0)
        studio.view.plan_panel.change(plan)
        await pilot.press("space")
        await studio.settle(pilot)
        (request,) = [asked[1] for asked in rig.asked if asked[0] == "burst"]
        assert isinstance(request, BurstRequest)
        assert (request.video, request.frames, request.seconds) == (True, None, None)

        rig.burst_status = BurstStatus(
            burst=4,
            name="recording-001",
            recording=True,
            cameras=2,
            instants=41,
            received=80,
            expected=82,
        )
        rig.tell()
        await studio.settle(pilot)
        assert "recording 0:0" in line_of(studio)
        assert "80 of 82 frames saved; Space stops" in line_of(studio)
        await pilot.press("space")
        await studio.settle(pilot)
        assert line_of(studio).endswith("; 80 of 82 frames saved; x cancels")
        assert "Space stops" not in line_of(studio)
        assert ("order", EndBurst(burst=4)) in rig.asked
        assert sum(asked[0] == "burst" for asked in rig.asked) == 1
        await pilot.press("space")
        await studio.settle(pilot)
        assert sum(asked[0] == "burst" for asked in rig.asked) == 2, "it takes again while the last is saved"


@pytest.mark.parametrize("chosen_s", [0.0, 10.0])
async def test_space_after_a_recording_that_ended_by_itself_says_so_first(
    tmp_path: Path, chosen_s: float
) -> None:
    rig = ready_rig(2)
    rig.saves, rig.is_recording = asyncio.Event(), True
    studio = Studio(rig, tmp_path)
    async with studio.running(120, 40) as pilot:
        panel = studio.view.plan_panel
        panel.change(replace(panel.settings, mode="recording", seconds=chosen_s))
        await pilot.press("space")
        await studio.settle(pilot)
        assert rig.burst_status is not None
        rig.burst_status = replace_fields(rig.burst_status, recording=True, ended=True)
        rig.tell()
        await studio.settle(pilot)
        for orders, said in ((1, True), (2, False)) if not chosen_s else ((2, False),):
            await pilot.press("space")
            await studio.settle(pilot)
            assert sum(asked[0] == "burst" for asked in rig.asked) == orders
            notes = " ".join(one.message for one in studio.app._notifications)
            assert ("burst-001 has ended by itself, after" in notes) is said
            studio.app.clear_notifications()


async def test_the_sheet_of_the_take_before_gives_way_to_a_recording(tmp_path: Path) -> None:
    rig = ready_rig(2)
    rig.take = saves_into(tmp_path, cameras=2)
    studio = Studio(rig, tmp_path)
    async with studio.running(120, 40) as pilot:
        await pilot.press("space")
        await until(pilot, lambda: studio.view.stage.is_sheet)
        rig.take, rig.saves = None, asyncio.Event()
        studio.view.plan_panel.change(TakeSettings(mode="recording"))
        await pilot.press("space")
        await studio.settle(pilot)
        assert not studio.view.stage.is_sheet, "what the cameras see is shown while they record"


def test_a_recording_of_a_planned_length_ends_by_itself() -> None:
    status = BurstStatus(
        burst=1, name="walk", recording=True, cameras=2, instants=90, received=0, expected=180
    )
    take = Take(status, TakePlan(video=True, seconds=5.0), begun_s=100.0)
    said = "recording 0:03 of 0:05: 0 of 180 frames saved"
    assert progress_words(take, 103.5) == said
    # The leader reports the end a little later than the screen's clock would.
    take.ended_s = 105.4
    assert progress_words(take, 109.0) == "recorded 0:05; 0 of 180 frames saved"


def test_a_wait_says_for_what_and_how_long() -> None:
    status = BurstStatus(
        burst=2, name="run", recording=True, cameras=2, instants=90, received=0, expected=180, ended=True
    )
    first, second = (
        Take(replace_fields(status, name=name), begun_s=100.0, ended_s=105.0) for name in ("walk", "run")
    )
    takes = [first, second]
    assert progress_words(second, 106.0, takes) == "recorded 0:05; waits until walk is saved"
    picture = Take(replace_fields(status, name="burst-001", recording=False), begun_s=100.0)
    assert progress_words(picture, 130.0, [first, picture]) == "taken 30 s ago; waits until walk is saved"
    assert progress_words(picture, 130.0, [picture, first]) == "taken; cameras are saving, 30 s"
    first.status = replace_fields(first.status, done=True)
    for now_s, received in ((110.0, 20), (120.0, 60)):
        second.status = replace_fields(second.status, received=received)
        second.note_saved(now_s)
    assert progress_words(second, 120.0, takes) == "recorded 0:05; 60 of 180 frames saved, some 30 s left"


async def test_space_ends_the_recording_of_a_leader_that_numbers_anew(tmp_path: Path) -> None:
    """The ended burst of that number counted as this one's end, and Space recorded beside it."""
    rig = ready_rig(2)
    studio = Studio(rig, tmp_path)
    recording = BurstStatus(
        burst=1, name="walk", recording=True, cameras=2, instants=41, received=80, expected=82
    )
    async with studio.running(120, 40) as pilot:
        rig.burst_status = recording
        rig.tell()
        await studio.settle(pilot)
        await pilot.press("space")
        rig.burst_status = replace_fields(recording, ended=True, done=True)
        rig.tell()
        await studio.settle(pilot)
        assert "Stop" not in footer_of(studio)
        # Another screen or a shell began it, with a leader that was started again.
        rig.burst_status = replace_fields(recording, name="run")
        rig.tell()
        await studio.settle(pilot)
        assert line_of(studio).endswith("; Space stops, x cancels")
        assert "space Stop" in footer_of(studio)
        rig.asked.clear()
        await pilot.press("space")
        await studio.settle(pilot)
        assert rig.asked == [("order", EndBurst(burst=1))]
        assert "Space stops" not in line_of(studio)
        assert "space Take" in footer_of(studio)


async def test_a_recording_that_others_ended_is_not_stopped_once_more(tmp_path: Path) -> None:
    rig = ready_rig(2)
    studio = Studio(rig, tmp_path)
    recording = BurstStatus(
        burst=4, name="walk", recording=True, cameras=2, instants=41, received=80, expected=82
    )
    async with studio.running(120, 40) as pilot:
        for said, ended in (("Space stops", False), ("; 80 of 82 frames saved", True)):
            rig.burst_status = replace_fields(recording, ended=ended)
            rig.tell()
            await studio.settle(pilot)
            assert said in line_of(studio)
        await pilot.press("space")
        await studio.settle(pilot)
        assert ("order", EndBurst(burst=4)) not in rig.asked
        assert sum(asked[0] == "burst" for asked in rig.asked) == 1, "it takes again while the last is saved"


async def test_a_series_on_motion_says_what_it_waits_for_and_is_stopped_by_the_key(tmp_path: Path) -> None:
    rig = ready_rig(2)
    rig.take = saves_into(tmp_path, cameras=2)
    studio = Studio(rig, tmp_path)
    async with studio.running(140, 40) as pilot:
        settings = replace(studio.view.plan_panel.settings, mode="motion", takes=2, every_s=0.0)
        studio.view.plan_panel.change(settings)
        await pilot.press("space")
        await until(pilot, lambda: "take 1 of 2: waiting for something to move" in line_of(studio))
        show_motion(rig, leader_ns=7 * 10**9)
        await until(pilot, lambda: "take 2 of 2: waiting for something to move" in line_of(studio))
        assert [take.status.name for take in studio.view.takes] == ["burst-001"]
        await pilot.press("space")
        await until(pilot, lambda: "waiting" not in line_of(studio))
        show_motion(rig, leader_ns=9 * 10**9)
        await studio.settle(pilot)
        assert [request.at_leader_ns for request in studio.requests] == [7 * 10**9]


async def test_a_take_whose_leader_is_lost_goes_on_when_it_is_back(tmp_path: Path) -> None:
    rig = ready_rig(2)
    rig.breaks_off, rig.saves = NetworkError("the leader closed the connection"), asyncio.Event()
    studio = Studio(rig, tmp_path)
    async with studio.running(120, 40) as pilot:
        await pilot.press("space")
        await studio.settle(pilot)
        rig.saves.set()
        await until(pilot, lambda: "the take may go on there" in studio.view.take_panel.plain)
        assert rig.burst_status is not None
        done = msgspec.structs.replace(
            rig.burst_status, received=16, done=True, session="/elsewhere/burst-001"
        )
        rig.burst_status = done
        rig.tell()
        await until(pilot, lambda: studio.view.takes[0].status.done)
        assert "saved on the leader's machine:\n/elsewhere/burst-001" in studio.view.take_panel.plain


async def test_a_saved_take_whose_images_arrive_at_last_is_shown_as_it_is_now(tmp_path: Path) -> None:
    rig = ready_rig(2)
    studio = Studio(rig, tmp_path)
    path = "/elsewhere/burst-001"
    parts = {name: CameraTransfer(camera=name, received=2, expected=2) for name in ("cam01", "cam02")}
    away = replace_fields(parts["cam02"], received=0, problem="it sent nothing")
    taken = BurstStatus(
        burst=1, name="burst-001", cameras=2, instants=2, received=2, expected=4, done=True, session=path,
        message="2 images missing (cam02: it sent nothing)", transfer=(parts["cam01"], away),
    )  # fmt: skip
    async with studio.running(120, 40) as pilot:

        async def shows(status: BurstStatus, *texts: str) -> None:
            rig.burst_status = status
            rig.tell()
            await until(pilot, lambda: all(text in studio.view.take_panel.plain for text in texts))

        await shows(taken, "2 of 4 images", "cam02    ░░░░░░░░░░ 0/2 ✖ it sent nothing")
        coming = replace_fields(away, received=1, problem="")
        arriving = replace_fields(taken, received=3, done=False, transfer=(parts["cam01"], coming))
        await shows(replace_fields(arriving, message="1 arriving"), "3 of 4 images", "1 arriving", "1/2")
        assert "saved" not in studio.view.take_panel.plain
        whole = replace_fields(taken, received=4, message="", transfer=tuple(parts.values()))
        await shows(whole, "saved on the leader's machine", "4 of 4 images")
        # A status from before it was saved may come last.
        rig.burst_status = replace_fields(arriving, session=None)
        rig.tell()
        await pilot.pause()
        assert "4 of 4 images" in studio.view.take_panel.plain


async def test_arriving_images_neither_lay_out_nor_redraw_what_has_not_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = ready_rig(2)
    studio = Studio(rig, tmp_path)
    saving = BurstStatus(
        burst=1, name="burst-001", cameras=2, instants=8, received=1, expected=16,
        transfer=(CameraTransfer(camera="cam00", received=1, expected=16),),
    )  # fmt: skip
    redrawn: list[tuple[Widget, bool]] = []
    refresh = Widget.refresh

    def shows(text: str) -> bool:
        return text in studio.view.take_panel.plain

    def noted(self: Widget, *regions: Region, layout: bool = False, **more: Any) -> Any:
        redrawn.append((self, layout))
        return refresh(self, *regions, layout=layout, **more)

    async with studio.running(120, 40) as pilot:
        for received in range(1, 9):
            if received == 2:
                await studio.settle(pilot)
                monkeypatch.setattr(Widget, "refresh", noted)
            part = CameraTransfer(camera="cam00", received=received, expected=16)
            rig.burst_status = replace_fields(saving, received=received, transfer=(part,))
            rig.tell()
            await until(pilot, partial(shows, f" {received}/16"))
        assert redrawn
        assert [widget for widget, lays_out in redrawn if lays_out or widget is studio.view.stage] == []


async def test_a_take_that_a_newer_one_replaced_is_done_when_its_session_is_saved(tmp_path: Path) -> None:
    rig = ready_rig(2)
    studio = Studio(rig, tmp_path)
    saving = BurstStatus(burst=1, name="burst-001", cameras=2, instants=3, received=0, expected=6)
    async with studio.running(120, 40) as pilot:
        rig.burst_status = saving
        rig.tell()
        await until(pilot, lambda: "burst-001\n◔ taken; cameras are saving" in studio.view.take_panel.plain)
        rig.burst_status = replace_fields(saving, burst=2, name="burst-002")
        rig.tell()
        await until(pilot, lambda: "burst-001  taken; cameras are saving" in studio.view.take_panel.plain)
        session = make_take(tmp_path, cameras=2, name="burst-001")
        rig.different["sessions"] = (str(session.folder),)
        rig.tell()
        await until(pilot, lambda: "burst-001  ● excellent" in studio.view.take_panel.plain)
        assert "burst-002\n◔ taken" in studio.view.take_panel.plain


def test_a_bar_leaves_its_numbers_on_its_line() -> None:
    transfer = CameraTransfer(camera="cam00", received=1234, expected=1800)
    for columns in (25, 36, 60):
        line = transfer_line(transfer, columns)
        assert line.cell_length <= columns
        assert line.plain.endswith(" 1234/1800")
    assert transfer_line(transfer, 60).plain.count("█") == 6
    wide = transfer_line(replace_fields(transfer, label="カメラ左を見る"), 25)
    assert wide.plain.startswith("カメラ左を見 ")
    assert wide.cell_length <= 25
