"""A rig that a screen started ends by itself once nobody uses it; those who do see its disk."""

import asyncio
from pathlib import Path

import pytest

from capture_app.common.errors import DiskError
from capture_app.node.leader import bursts
from capture_app.node.leader.bursts import LOOK_EVERY_NS
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


async def test_a_status_has_the_room_of_the_disk_as_it_is_now(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rooms = iter([9, 5])

    def free_bytes(_: Path) -> int:
        if (room := next(rooms, None)) is None:
            raise DiskError("it does not answer")
        return room

    monkeypatch.setattr(bursts, "free_bytes", free_bytes)
    async with await start_leader(tmp_path) as node:
        rooms_seen = []
        for _ in range(5):
            rooms_seen.append((await ask_status(node.own_address)).disk_free_bytes)
            await asyncio.sleep(0.6 * LOOK_EVERY_NS / 1e9)
    assert rooms_seen == [9, 9, 5, 5, None], "a disk that hangs may not hold up each status"
