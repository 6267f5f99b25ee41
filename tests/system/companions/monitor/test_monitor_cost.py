"""Three open monitors of ten cameras and a leader in a process of its own."""

import asyncio
import os
import statistics
import time
from collections.abc import AsyncIterator, Coroutine
from contextlib import AsyncExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from capture_app.common.node_state import NodeState
from capture_app.companions.monitor.monitor_page import serving_monitor
from capture_app.protocol.orders import StopRig
from capture_app.rig.process import LeaderRecord, start_rig
from capture_app.rig.rig_link import RigLink, ask_status
from capture_app.web.admission import Admission
from capture_app.web.paired_page import ListeningPage
from tests.cheap_rig import cheap_cameras
from tests.unit.companions.monitor.served import StandInMonitor
from tests.waiting import SLOW_PATIENCE_S, time_limit

CAMERAS, MONITORS, PICTURES = 10, 3, 20
TOLERANCE_NS = 100_000
"""The rig's default tolerance of a phase error."""


@dataclass(frozen=True)
class Load:
    leader_cores: float
    phase_error_ns: float
    """Median of the cameras' absolute values."""
    wall_s: float


async def load(rig: LeaderRecord, *work: Coroutine[Any, Any, None]) -> Load:
    """Do work, and return what the leader used and the phase errors during it."""
    began_s, used_s, errors = time.monotonic(), cpu_s(rig.pid), []
    working = asyncio.gather(*work)
    while not working.done():
        nodes = (await ask_status(rig.address)).nodes
        errors += [abs(node.phase_error_ns) for node in nodes if node.phase_error_ns is not None]
        await asyncio.wait([working], timeout=0.5)
    await working
    wall_s = time.monotonic() - began_s
    return Load((cpu_s(rig.pid) - used_s) / wall_s, statistics.median(errors), wall_s)


def cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


async def watch(monitor: StandInMonitor) -> None:
    """Acknowledge pictures at once, until each camera has sent enough."""
    while len(monitor.pictures) < CAMERAS or min(map(len, monitor.pictures.values())) < PICTURES:
        if await monitor.hear() == "live":
            await monitor.say(type="seen", picture="live")


@pytest.fixture
async def rig(tmp_path: Path) -> AsyncIterator[LeaderRecord]:
    rig = await start_rig(sessions=tmp_path / "sessions", host="127.0.0.1", is_owned=True)
    yield rig
    await RigLink(rig.address).order(StopRig())


async def test_three_monitors_get_all_pictures_and_leave_the_cameras_in_phase(
    rig: LeaderRecord, capsys: pytest.CaptureFixture[str]
) -> None:
    page = ListeningPage(Admission(time.monotonic, "monitor"), "127.0.0.1", 0, 0)
    async with AsyncExitStack() as stack:
        await stack.enter_async_context(cheap_cameras(CAMERAS, rig.address))
        await stack.enter_async_context(serving_monitor(RigLink(rig.address), page, is_local=True))
        async with time_limit("all cameras to be ready", SLOW_PATIENCE_S):
            while True:
                nodes = (await ask_status(rig.address)).nodes
                if [node.state for node in nodes] == [NodeState.READY] * CAMERAS:
                    break
                await asyncio.sleep(0.5)
        idle = await load(rig, asyncio.sleep(6))
        monitors = [
            await stack.enter_async_context(StandInMonitor(page, f"{number:032d}"))
            for number in range(MONITORS)
        ]
        for monitor in monitors:
            await monitor.open()
        watched = await load(rig, *(watch(monitor) for monitor in monitors))
    with capsys.disabled():
        print(f"\nwithout monitors: {idle}\nwith {MONITORS}: {watched}")
    assert watched.phase_error_ns < TOLERANCE_NS
