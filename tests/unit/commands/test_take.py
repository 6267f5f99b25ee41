"""What `capture-app burst` and `record` print of a take; tests/unit/rig/test_taking.py tests the take."""

import asyncio
import os
import signal
from pathlib import Path
from typing import Any

import msgspec
import pytest

from capture_app.commands.take import require_whole, take
from capture_app.common.errors import IncompleteError, NetworkError, NoCameraHereError
from capture_app.protocol.orders import EndBurst
from capture_app.protocol.status import BurstStatus
from capture_app.rig.taking import Failed, Progress, Saved, TakePlan
from tests.unit.tui.fake_rig import FakeRig, make_node, show_motion
from tests.unit.tui.shoot.studio import saves_into
from tests.waiting import time_limit, until


@pytest.fixture
def rig(tmp_path: Path) -> FakeRig:
    rig = FakeRig()
    rig.nodes = (make_node("cam00"), make_node("cam01"))
    rig.take = saves_into(tmp_path, cameras=2)
    return rig


async def run(rig: FakeRig, *, detach: bool = False, **plan: Any) -> list[Progress | Saved | Failed]:
    ended: list[Progress | Saved | Failed] = []
    async with time_limit(f"the end of {plan}"):
        await take(rig, TakePlan(**plan), ended, silent=False, detach=detach)
    return ended


async def test_a_wait_is_said_once_for_each_reason(rig: FakeRig, capsys: pytest.CaptureFixture[str]) -> None:
    rig.is_ready = asyncio.Event()
    running = asyncio.create_task(run(rig, wait_ready_s=9))
    await until(lambda: rig.asked)
    rig.is_ready.set()
    await running
    assert capsys.readouterr().err.count("waiting for the rig: cam01 is aligning\n") == 1


async def test_a_countdown_is_said_each_second(rig: FakeRig, capsys: pytest.CaptureFixture[str]) -> None:
    await run(rig, countdown_s=1.2)
    lines = capsys.readouterr().err.splitlines()
    assert lines[:2] == ["take 1 of 1 in 2 s", "take 1 of 1 in 1 s"]


async def test_motion_names_the_camera(rig: FakeRig, capsys: pytest.CaptureFixture[str]) -> None:
    running = asyncio.create_task(run(rig, on_motion=(0, 0, 1, 1)))
    await until(lambda: rig.asked)
    show_motion(rig, leader_ns=7)
    await running
    lines = capsys.readouterr().err.splitlines()
    assert lines[:2] == ["waiting for something to move", "something moves in front of cam01"]


async def test_each_take_of_a_series_is_a_path(
    rig: FakeRig, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    await run(rig, frames=2, repeat=2, name="jump")
    said = capsys.readouterr()
    assert said.out.splitlines() == [str(tmp_path / "jump-001"), str(tmp_path / "jump-002")]
    assert "excellent" in said.err
    # The same command again takes again.
    await run(rig, frames=2, name="jump")
    assert capsys.readouterr().out == f"{tmp_path / 'jump-003'}\n"


async def test_a_lost_leader_is_said_and_then_where_the_take_is(
    rig: FakeRig, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig.breaks_off = NetworkError("the leader closed the connection")
    running = asyncio.create_task(run(rig, frames=3))
    await until(lambda: rig.is_lost)
    await until(lambda: rig._others)
    assert rig.burst_status is not None
    done = {"received": 6, "done": True, "session": str(tmp_path / "burst-001")}
    rig.burst_status = msgspec.structs.replace(rig.burst_status, **done)
    rig.tell()
    await running
    said = capsys.readouterr()
    assert "burst 1: 2 of 6 images, the leader closed the connection; the take may go on there" in said.err
    assert said.out == f"{tmp_path / 'burst-001'}\n"


async def test_without_a_camera_it_says_how_to_start_one(rig: FakeRig) -> None:
    rig.failure = NoCameraHereError("no camera is here")
    (failed,) = await run(rig)
    with pytest.raises(NoCameraHereError, match=r"capture-app node --leader 127\.0\.0\.1:47010"):
        require_whole(failed)


async def test_the_first_interrupt_ends_a_recording(rig: FakeRig) -> None:
    rig.saves, rig.is_recording, rig.take = asyncio.Event(), True, None
    running = asyncio.create_task(run(rig, video=True))
    await until(lambda: rig.burst_status is not None)
    await until(rig.is_heard)
    os.kill(os.getpid(), signal.SIGINT)
    await until(lambda: ("order", EndBurst(burst=1)) in rig.asked)
    assert not running.done()
    rig.saves.set()
    await running


async def test_detached_it_returns_when_the_recording_has_begun(rig: FakeRig) -> None:
    rig.saves, rig.is_recording, rig.take = asyncio.Event(), True, None
    (begun,) = await run(rig, detach=True, video=True)
    assert isinstance(begun, Progress)
    assert not begun.status.done


def saved(received: int) -> Saved:
    status = BurstStatus(
        burst=1, name="r", cameras=2, instants=450, received=received, expected=900, done=True, session="s"
    )
    return Saved(1, status)


def test_few_missing_frames_are_said_and_no_failure(capsys: pytest.CaptureFixture[str]) -> None:
    require_whole(saved(900), 1.0)
    assert capsys.readouterr().err == ""
    require_whole(saved(899), 1.0)
    assert "1 of 900 frames missing" in capsys.readouterr().err


@pytest.mark.parametrize(("received", "max_missing_pct"), [(890, 1.0), (899, 0.0), (0, 99.0)])
def test_more_than_was_asked_for_is_incomplete(received: int, max_missing_pct: float) -> None:
    with pytest.raises(IncompleteError, match="incomplete"):
        require_whole(saved(received), max_missing_pct)


async def test_the_verdict_of_an_incomplete_take_is_said_once(
    rig: FakeRig, capsys: pytest.CaptureFixture[str]
) -> None:
    (ended,) = await run(rig, frames=3)
    assert isinstance(ended, Saved)
    assert ended.verdict is not None
    with pytest.raises(IncompleteError) as raised:
        require_whole(msgspec.structs.replace(ended, status=saved(899).status))
    assert str(raised.value).startswith("r is incomplete: 1 of 900 images missing (")
    assert (capsys.readouterr().err + str(raised.value)).count(ended.verdict.headline) == 1
