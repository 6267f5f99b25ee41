"""Taking pictures, by its events: what Python sees. Command line and screen show the same in their own way.

             Python (this module)          command (commands/test_take.py)   screen (tui/shoot)
wait         Waiting, then Begun           a line for each reason            line below; Space takes now
countdown    Countdown, each second        a line each second                large digits; Space stops it
motion       Moved; frames around it       a line names the camera           a notice; Space stops it
repeat       numbered takes                a path for each                   a sheet for each
cancel       cancel(), stop()              --cancel BURST, Ctrl-C            x, Escape
retake       the same plan again           the same command again            r, with the plan of the last
lost leader  Progress says so, then Saved  a line, then the path             in the panel, then its sheet
"""

import asyncio
import sys
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import asynccontextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import click
import msgspec
import numpy as np
import pytest

from capture_app.cameras.specs import open_camera
from capture_app.commands.take import burst, record
from capture_app.common.address import Address
from capture_app.common.clock import HostClock
from capture_app.common.errors import (
    BadInputError,
    DiskFullError,
    IncompleteError,
    NetworkError,
    NotAvailableError,
)
from capture_app.common.node_state import RELAY, NodeState
from capture_app.common.take_limits import LIMITS
from capture_app.node.camera.camera_node import CameraNode
from capture_app.node.camera.supervisor import NodeOptions
from capture_app.protocol.messages import BurstRequest
from capture_app.protocol.orders import CancelBurst, EndBurst
from capture_app.rig.rig_link import RigLink
from capture_app.rig.taking import (
    Begun,
    Countdown,
    Failed,
    Moved,
    Progress,
    Saved,
    TakeEvent,
    TakePlan,
    Taking,
    Waiting,
)
from tests.cheap_rig import start_leader
from tests.facts import make_facts
from tests.unit.tui.fake_rig import FakeRig, make_node, show_motion
from tests.unit.tui.shoot.studio import saves_into
from tests.waiting import SLOW_PATIENCE_S, time_limit, until

pytestmark = pytest.mark.virtual


def test_a_take_waits_for_cameras_that_settle_unless_it_is_told_by_motion() -> None:
    rig = FakeRig(2)
    settling = make_node("cam02", NodeState.ALIGNING, phase_error_ns=7_310_000)
    steady = (
        *rig.nodes,
        make_node("cam03", NodeState.LOST),
        make_node("cam04", NodeState.ALIGNING, phase_error_ns=-110_000),
        make_node("relay", NodeState.SYNCING, camera=make_facts(kind=RELAY)),
    )
    rig.nodes = steady
    plan = TakePlan(frames=3)
    assert plan.when_ready(None) == plan.when_ready(rig.status()) == plan
    rig.nodes = (*steady, settling)
    waits = plan.when_ready(rig.status())
    assert (waits.wait_ready_s, waits.nodes, waits.frames) == (120.0, 4, 3), "not for lost ones and relays"
    moved = TakePlan(on_motion=(0.0, 0.0, 1.0, 1.0))
    assert moved.when_ready(rig.status()) == moved


@pytest.fixture
def rig(tmp_path: Path) -> FakeRig:
    """Two cameras that are ready, and save into the test's folder."""
    rig = FakeRig()
    rig.nodes = (make_node("cam00"), make_node("cam01"))
    rig.take = saves_into(tmp_path, cameras=2)
    return rig


def course(events: list[TakeEvent]) -> list[str]:
    """The events without the progress between them, as `begun 1`."""
    return [
        f"{type(event).__name__.lower()} {event.number}"
        for event in events
        if not isinstance(event, Progress)
    ]


async def events_of(rig: RigLink, **plan: Any) -> list[TakeEvent]:
    async with time_limit(f"the end of {plan}"):
        return [event async for event in Taking(rig, TakePlan(**plan))]


def requests(rig: FakeRig) -> list[BurstRequest]:
    return [asked[1] for asked in rig.asked if isinstance(asked[1], BurstRequest)]


def tasks() -> set[Any]:
    return asyncio.all_tasks()


async def test_a_take_begins_goes_on_and_is_judged(rig: FakeRig) -> None:
    events = await events_of(rig, frames=3, before=1, name="jump")
    assert course(events) == ["begun 1", "saved 1"]
    assert [event.status.received for event in events if isinstance(event, Progress)] == [0, 2, 4, 6]
    saved = events[-1]
    assert isinstance(saved, Saved)
    assert saved.verdict is not None
    assert (saved.verdict.grade, saved.open().name) == ("excellent", "jump-001")
    assert [(request.frames, request.before) for request in requests(rig)] == [(3, 1)]


@pytest.mark.skipif(sys.version_info < (3, 12), reason="eager tasks came with Python 3.12")
async def test_a_take_may_begin_within_its_order(rig: FakeRig) -> None:
    asyncio.get_running_loop().set_task_factory(getattr(asyncio, "eager_task_factory", None))
    assert course(await events_of(rig, frames=3)) == ["begun 1", "saved 1"]


async def test_a_session_of_another_machine_is_not_judged(rig: FakeRig) -> None:
    async def elsewhere(request: BurstRequest) -> str:
        return "/home/ada/sessions/burst-001"

    rig.take = elsewhere
    saved = await Taking(rig, TakePlan(frames=1)).result()
    assert (saved.session, saved.verdict) == ("/home/ada/sessions/burst-001", None)
    with pytest.raises(NotAvailableError, match="/home/ada"):
        saved.open()


async def test_it_waits_until_the_rig_is_ready(rig: FakeRig) -> None:
    rig.is_ready = asyncio.Event()
    events = []
    async with time_limit("a take"):
        async for event in (taking := Taking(rig, TakePlan(frames=1, wait_ready_s=20, nodes=2))):
            events.append(event)
            if isinstance(event, Waiting):
                assert (event.reason, taking.is_waiting) == ("waiting for the rig: cam01 is aligning", True)
                rig.is_ready.set()
    assert course(events) == ["waiting 1", "begun 1", "saved 1"]
    assert not taking.is_open


async def test_a_wait_ends_in_a_take_at_once_or_is_taken_back(rig: FakeRig) -> None:
    rig.is_ready = asyncio.Event()
    hurried, stopped = (
        Taking(rig, TakePlan(wait_ready_s=20, repeat=2)),
        Taking(rig, TakePlan(wait_ready_s=20)),
    )
    events = []
    async with time_limit("a take at once"):
        async for event in hurried:
            events.append(event)
            if isinstance(event, Waiting):
                hurried.take_now()
    assert course(events) == ["waiting 1", "begun 1", "saved 1", "begun 2", "saved 2"]
    async with time_limit("no take"):
        async for event in stopped:
            assert isinstance(event, Waiting)
            stopped.stop()
    assert [request.wait_ready_s for request in requests(rig)] == [20, 0, 0, 20]
    assert not stopped.is_open


async def test_a_countdown_reports_each_second(rig: FakeRig) -> None:
    events = await events_of(rig, frames=1, countdown_s=1.2)
    assert course(events) == ["countdown 1", "countdown 1", "begun 1", "saved 1"]
    assert [event.seconds for event in events if isinstance(event, Countdown)] == [2, 1]


async def test_a_series_takes_the_next_when_the_last_is_saved(rig: FakeRig) -> None:
    events = await events_of(rig, frames=1, repeat=3)
    assert course(events) == ["begun 1", "saved 1", "begun 2", "saved 2", "begun 3", "saved 3"]


async def test_at_an_interval_the_next_is_taken_while_the_last_is_being_saved(rig: FakeRig) -> None:
    rig.saves = asyncio.Event()
    events = []
    async with time_limit("three takes"):
        async for event in Taking(rig, TakePlan(frames=1, repeat=3, every_s=0.1)):
            events.append(event)
            if isinstance(event, Begun) and event.number == 3:
                rig.saves.set()
    begun = [line for line in course(events) if not line.startswith("countdown")]
    assert begun[:3] == ["begun 1", "begun 2", "begun 3"]
    assert sorted(begun[3:]) == ["saved 1", "saved 2", "saved 3"]


async def test_takes_that_a_rig_was_not_ready_for_are_not_made_up_for(rig: FakeRig) -> None:
    loop, rig.is_ready, begun_s = asyncio.get_running_loop(), asyncio.Event(), []
    loop.call_later(10.0, rig.is_ready.set)
    async for event in Taking(rig, TakePlan(frames=1, repeat=4, every_s=1.0, wait_ready_s=20)):
        if isinstance(event, Begun):
            begun_s.append(loop.time())
    assert all(later - earlier > 0.9 for earlier, later in pairwise(begun_s))


async def test_a_series_at_an_interval_is_not_later_by_what_each_order_takes(rig: FakeRig) -> None:
    class SoonReady(asyncio.Event):
        async def wait(self) -> Literal[True]:
            await asyncio.sleep(0.3)
            return True

    loop, rig.is_ready, begun_s = asyncio.get_running_loop(), SoonReady(), []
    async for event in Taking(rig, TakePlan(frames=1, repeat=4, every_s=1.0, wait_ready_s=20)):
        if isinstance(event, Begun):
            begun_s.append(loop.time())
    assert np.diff(begun_s) == pytest.approx(1.0, abs=0.1)


async def test_the_result_is_the_last_take_also_if_an_earlier_one_is_saved_later(rig: FakeRig) -> None:
    class SavedBackwards(Taking):
        async def __aiter__(self) -> AsyncGenerator[TakeEvent, None]:
            events = [event async for event in super().__aiter__()]
            for event in sorted(events, key=lambda event: -event.number):
                yield event

    async with time_limit("two takes"):
        assert (await SavedBackwards(rig, TakePlan(frames=1, repeat=2, every_s=0.1)).result()).number == 2


async def test_motion_orders_the_frames_around_it(rig: FakeRig) -> None:
    events = []
    async with time_limit("two takes on motion"):
        async for event in Taking(rig, TakePlan(before=2, repeat=2, on_motion=(0, 0, 0.5, 1))):
            events.append(event)
            if isinstance(event, Waiting):
                show_motion(rig, leader_ns=7 * event.number)
    assert course(events)[:4] == ["waiting 1", "moved 1", "begun 1", "saved 1"]
    assert {event.camera for event in events if isinstance(event, Moved)} == {"cam01"}
    assert [(request.at_leader_ns, request.before) for request in requests(rig)] == [(7, 2), (14, 2)]


async def test_what_moves_outside_the_region_takes_nothing(rig: FakeRig) -> None:
    taking = Taking(rig, TakePlan(on_motion=(0.5, 0, 1, 1)))
    async with time_limit("all that is seen"):
        async for event in taking:
            assert isinstance(event, Waiting)
            show_motion(rig, leader_ns=7)
            await until(rig.is_heard)
            taking.stop()
    assert requests(rig) == []


async def test_a_take_that_fails_ends_a_series_but_not_what_goes_by_the_clock(rig: FakeRig) -> None:
    rig.failure = DiskFullError("the disk is full", hint="make room")
    assert course(await events_of(rig, repeat=3)) == ["failed 1"]
    rig.failure = DiskFullError("the disk is full", hint="make room")
    assert "failed 1" in course(await events_of(rig, repeat=3, every_s=0.1))
    assert len(requests(rig)) <= 3
    later = []
    async for event in Taking(rig, TakePlan(repeat=3, every_s=0.3)):
        later += course([event])
        if isinstance(event, Saved) and event.number == 1:
            rig.failure = DiskFullError("the disk is full", hint="make room")
    assert [line for line in later if line[:4] in ("save", "fail")] == ["saved 1", "failed 2", "saved 3"]
    rig.failure = DiskFullError("the disk is full", hint="make room")
    with pytest.raises(DiskFullError):
        await Taking(rig, TakePlan()).result()


async def test_a_take_of_which_nothing_came_has_failed(rig: FakeRig) -> None:
    rig.take = None
    (failed,) = [event for event in await events_of(rig, frames=1) if isinstance(event, Failed)]
    assert isinstance(failed.error, IncompleteError)
    assert failed.status is not None


async def test_cancel_orders_it_of_what_has_begun(rig: FakeRig) -> None:
    rig.saves = asyncio.Event()
    taking = Taking(rig, TakePlan(frames=2, repeat=5))
    async with time_limit("a cancelled take"):
        async for event in taking:
            if isinstance(event, Begun):
                await taking.cancel()
                rig.saves.set()
    assert isinstance(event, Saved)
    assert ("order", CancelBurst(burst=1)) in rig.asked
    assert len(requests(rig)) == 1


async def test_the_same_plan_is_a_retake(rig: FakeRig) -> None:
    taken = [await Taking(rig, plan).result() for plan in [TakePlan(frames=2, name="jump")] * 2]
    assert [saved.status.name for saved in taken] == ["jump-001", "jump-002"]


@pytest.mark.parametrize("told", ["status", "sessions"])
async def test_a_leader_lost_in_the_middle_is_found_again(rig: FakeRig, tmp_path: Path, told: str) -> None:
    rig.breaks_off = NetworkError("the leader closed the connection")
    events = []
    async with time_limit("a take that was lost"):
        async for event in Taking(rig, TakePlan(frames=3)):
            events.append(event)
            if isinstance(event, Progress) and "may go on there" in event.status.message:
                rig.lose_link()
                session = str(tmp_path / "burst-001")
                if told == "status":
                    done = {"received": 6, "done": True, "session": session}
                    rig.burst_status = msgspec.structs.replace(event.status, message="", **done)
                else:
                    rig.burst_status, rig.different["sessions"] = None, (session,)
                rig.tell()
    assert course(events) == ["begun 1", "saved 1"]
    saved = events[-1]
    assert isinstance(saved, Saved)
    assert (saved.status.received, saved.verdict is not None) == (6, True)


async def test_a_leader_that_stays_away_is_said_with_what_is_known(rig: FakeRig) -> None:
    rig.breaks_off = NetworkError("the leader closed the connection")
    failed = (await events_of(rig, frames=3, wait_leader_s=0.05))[-1]
    assert isinstance(failed, Failed)
    assert isinstance(failed.error, NetworkError)
    assert "2 of 6 images of burst-001" in failed.error.what
    assert failed.status is not None


async def test_a_take_of_a_lost_leader_is_not_ended_by_its_number_there(rig: FakeRig) -> None:
    """The leader's next run has other takes of these numbers."""
    rig.breaks_off = NetworkError("the leader closed the connection")
    async for event in (taking := Taking(rig, TakePlan(frames=3, wait_leader_s=0.05))):
        if isinstance(event, Progress) and "may go on there" in event.status.message:
            await taking.end()
    assert [asked[1] for asked in rig.asked if asked[0] == "order"] == [EndBurst(burst=0)]


@pytest.mark.parametrize("how", ["left", "cancelled"])
async def test_an_iteration_that_does_not_end_leaves_nothing_running(rig: FakeRig, how: str) -> None:
    rig.is_ready, before = asyncio.Event(), tasks()
    taking = Taking(rig, TakePlan(wait_ready_s=20, repeat=3))

    async def iterate() -> None:
        async for event in taking:
            if isinstance(event, Waiting) and how == "left":
                break

    task = asyncio.create_task(iterate())
    if how == "cancelled":
        await until(lambda: taking.is_waiting)
        task.cancel()
    await asyncio.gather(task, return_exceptions=True)
    await until(lambda: tasks() == before)


def test_a_name_with_blanks_is_a_folders_name() -> None:
    assert TakePlan(name=" my  take").name == "my-take"


@pytest.mark.parametrize(
    ("plan", "says"),
    [
        ({"frames": 0}, "frames of a take is 0"),
        ({"before": -1}, "before"),
        ({"repeat": 0}, "repeat"),
        ({"every_s": float("nan")}, "every_s"),
        ({"countdown_s": "3"}, "countdown_s of a take is '3'"),
        ({"frames": 3.0}, "frames of a take is 3.0"),
        ({"frames": np.float64(3)}, "frames of a take is"),
        ({"nodes": "2"}, "nodes of a take is '2'"),
        ({"at_leader_ns": 1 << 63}, "at_leader_ns"),
        ({"frames": 2, "before": 3}, "3 of 2 frames cannot be taken before"),
        ({"video": True, "before": 10}, "no frames from before"),
        ({"seconds": 2.0, "before": 10}, "no frames from before"),
        ({"note": 5}, "note"),
        ({"name": "../up"}, "not a valid name for a take"),
        ({"on_motion": (0.5, 0, 0.5, 1)}, "not a region"),
        ({"at_leader_ns": 5, "repeat": 2}, "at a given time"),
        ({"at_leader_ns": 5, "on_motion": (0, 0, 1, 1)}, "at a given time"),
    ],
)
def test_an_impossible_plan_is_refused(plan: dict[str, Any], says: str) -> None:
    with pytest.raises(BadInputError, match=says):
        TakePlan(**plan)


def test_numbers_of_numpy_are_taken_as_numbers() -> None:
    numbers: dict[str, Any] = {"frames": np.int64(3), "before": np.uint8(1), "repeat": np.int32(2)}
    plan = TakePlan(**numbers | {"every_s": np.float32(0.5), "countdown_s": 1})
    assert plan == TakePlan(frames=3, before=1, repeat=2, every_s=0.5, countdown_s=1.0)
    sent = msgspec.json.decode(msgspec.json.encode(plan.request()), type=BurstRequest)
    assert (sent.frames, sent.before) == (3, 1)


@pytest.mark.parametrize("field", LIMITS)
def test_command_and_leader_have_the_limits_of_a_plan(field: str) -> None:
    low, high = LIMITS[field]
    values: dict[str, Any] = {"frames": 1000} if field == "before" else {}
    for value in (low, high):
        plan = TakePlan(**{**values, field: value})
        msgspec.json.decode(msgspec.json.encode(plan.request()), type=BurstRequest)
    with pytest.raises(BadInputError, match=f"{field} of a take"):
        TakePlan(**{**values, field: high * 2 + 1})
    typed = [of for command in (burst, record) for of in command.params if of.name == field]
    limits = {
        (of.type.min, of.type.max) for of in typed if isinstance(of.type, click.IntRange | click.FloatRange)
    }
    if field != "every_s":  # of `record` it is the time between frames
        assert limits in (set(), {(low, high)})


@asynccontextmanager
async def camera_of(address: Address) -> AsyncIterator[None]:
    """A camera that joins this leader, and again after a restart."""
    spec, clock = "sim:perfect,scale=0.1", HostClock()
    options = NodeOptions(
        name="a",
        open_camera=lambda: open_camera(spec, clock=clock, name="a"),
        leaders=(address,),
        clock=clock,
    )
    running = asyncio.create_task(CameraNode(options).run())
    try:
        yield
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)


async def test_a_recording_is_ended(tmp_path: Path) -> None:
    async with await start_leader(tmp_path) as leader, camera_of(leader.own_address):
        taking = Taking(RigLink(leader.own_address), TakePlan(video=True, wait_ready_s=SLOW_PATIENCE_S))
        async with time_limit("a recording", SLOW_PATIENCE_S):
            async for event in taking:
                # Again and again: the last order comes when the recording is over.
                if isinstance(event, Progress) and event.status.received > 5:
                    await taking.end()
            assert isinstance(event, Saved)
            await RigLink(leader.own_address).order(EndBurst(burst=event.status.burst))
            with pytest.raises(BadInputError, match="burst 7 is not a recording under way"):
                await RigLink(leader.own_address).order(EndBurst(burst=7))
    assert (event.status.name, event.verdict is not None) == ("recording-001", True)


def test_a_take_by_its_duration_skips_no_instants() -> None:
    assert (TakePlan(frames=5).request().frames, TakePlan(frames=5).request().spare) == (5, None)
    for plan in (TakePlan(frames=5, video=True), TakePlan(frames=5, seconds=2.0)):
        assert (plan.request().frames, plan.request().spare) == (None, 0)
