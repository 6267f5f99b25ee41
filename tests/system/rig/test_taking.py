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
import dataclasses
from pathlib import Path

import pytest

from capture_app.node.leader.leader_node import LeaderNode
from capture_app.node.leader.leader_options import LeaderOptions
from capture_app.rig.rig_link import RigLink
from capture_app.rig.taking import (
    TakePlan,
    Taking,
)
from tests.unit.rig.test_taking import camera_of
from tests.waiting import SLOW_PATIENCE_S, time_limit, until

pytestmark = pytest.mark.virtual


async def test_a_take_is_followed_through_a_restart_of_its_leader(tmp_path: Path) -> None:
    options = LeaderOptions(sessions=tmp_path, host="127.0.0.1", port=0)
    leader = await LeaderNode.start(options)
    address = leader.own_address
    async with camera_of(address):
        async with leader:
            taking = Taking(RigLink(address), TakePlan(frames=3, wait_ready_s=SLOW_PATIENCE_S))
            taken = asyncio.create_task(taking.result())
            await until(lambda: taking._active)
        async with (
            await LeaderNode.start(dataclasses.replace(options, port=address.port, return_ns=10**9)),
            time_limit("its session", SLOW_PATIENCE_S),
        ):
            saved = await taken
    assert saved.open().name == "burst-001"
