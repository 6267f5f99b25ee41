"""A screen's link to a leader that goes and comes back."""

import asyncio
from contextlib import suppress
from pathlib import Path
from typing import Any, cast

import pytest
from msgspec.structs import replace

from capture_app.common.address import Address
from capture_app.common.errors import BadInputError
from capture_app.protocol.orders import LogAnswer
from capture_app.protocol.status import LogLine, Preview, RigStatus
from capture_app.rig.rig_link import LinkLost, RigLink, Update, camera_named
from tests.cheap_rig import cheap_cameras, start_leader
from tests.unit.tui.fake_rig import FakeRig
from tests.waiting import time_limit, until

pytestmark = pytest.mark.virtual


async def test_a_link_that_is_lost_opens_again_with_its_previews(tmp_path: Path, open_rig: None) -> None:
    leader = await start_leader(tmp_path)
    link = RigLink(leader.own_address)
    told = list[Update]()

    async def follow() -> None:
        async for update in link.updates():
            told.append(update)

    def of(kind: type[Update]) -> list[Update]:
        return [update for update in told if isinstance(update, kind)]

    following = asyncio.create_task(follow())
    async with time_limit("the link"), cheap_cameras(1, leader.own_address):
        await until(lambda: any(isinstance(one, RigStatus) and one.nodes for one in told))
        assert not of(Preview), "none is asked for"
        await link.want_previews(cameras=None, width=160, fps=10.0)
        await until(lambda: len(of(Preview)) > 3)
        assert all(one.jpeg.startswith(b"\xff\xd8") for one in told if isinstance(one, Preview))
        port = leader.own_address.port
        await leader.stop()
        await until(lambda: of(LinkLost) != [])
        # Several attempts fail, and one sentence says so.
        await asyncio.sleep(5)
        assert [one.reason for one in told if isinstance(one, LinkLost)][1:] == []
        assert f"capture-app rig start --port {port}" in str(of(LinkLost)[0])
        del told[:]
        async with await start_leader(tmp_path, port=port):
            # Nobody asks again.
            await until(lambda: len(of(Preview)) > 3)
            assert of(RigStatus)
        await until(lambda: of(LinkLost) != [])
    lines = [one.unix_ns for one in told if isinstance(one, LogLine)]
    assert lines == sorted({*lines})
    following.cancel()
    with suppress(asyncio.CancelledError):
        await following


async def test_lines_of_the_log_that_a_reopened_connection_sends_again_are_told_once() -> None:
    link, told = RigLink(Address("127.0.0.1", 1)), list[Update]()
    lines = tuple(LogLine(unix_ns=number, text=f"line {number}") for number in (1, 2, 3))
    for upto in (2, 2, 3):
        async for update in link._read(cast(Any, None), LogAnswer(lines=lines[:upto])):
            told.append(update)
    assert told == [*lines]


def test_a_person_means_a_camera_by_its_label_and_then_by_its_name() -> None:
    nodes = FakeRig(4).status().nodes
    labels = ("Böhm", "カメラ", "カメラ", "cam00")
    called = [replace(n, camera=replace(n.camera, label=said)) for n, said in zip(nodes, labels, strict=True)]
    rig = replace(FakeRig(4).status(), nodes=tuple(called))
    names = [node.name for node in nodes]
    assert rig.titles[names[1]] == f"カメラ ({names[1]})", "two are called so"
    assert [camera_named(rig, text) for text in ("Bo\u0308hm", "BÖHM")] == [names[0]] * 2
    assert camera_named(rig, "cam00") == names[3], "a label before another camera's name"
    assert camera_named(rig, names[1]) == names[1]
    assert camera_named(rig, "gone-7") == "gone-7", "the leader may know it from before"
    with pytest.raises(BadInputError, match="the rig has no camera カメラ"):
        camera_named(rig, "カメラ")
