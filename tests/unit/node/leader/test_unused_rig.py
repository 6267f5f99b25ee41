"""A rig that a screen started ends by itself once nobody uses it."""

import asyncio
from pathlib import Path

import pytest

from capture_app.node.leader.watchers import UNUSED_NS
from capture_app.rig.rig_link import ask_status
from tests.cheap_rig import start_leader
from tests.unit.node.joining import joined

pytestmark = [pytest.mark.usefixtures("open_rig"), pytest.mark.virtual]
CAM0, UNUSED_S = 1234567, UNUSED_NS / 1e9


async def test_a_rig_ends_once_no_operator_asks(tmp_path: Path) -> None:
    async with await start_leader(tmp_path) as node:
        ends = asyncio.create_task(node.wait_until_unused())
        for _ in range(3):
            await ask_status(node.own_address)
            await asyncio.sleep(0.7 * UNUSED_S)
            assert not ends.done()
        await asyncio.wait_for(ends, 0.4 * UNUSED_S)


async def test_a_rig_that_had_a_camera_stays(tmp_path: Path) -> None:
    async with await start_leader(tmp_path) as node:
        async with joined(node.own_address, ("cam0", CAM0)):
            pass
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(node.wait_until_unused(), 2 * UNUSED_S)
