"""Previews and details on their way from a node to whoever looks: asked for, acknowledged, held back."""

import asyncio
from collections.abc import AsyncGenerator, AsyncIterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest.mock import AsyncMock

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from capture_app.cameras.frames import CapturedFrame
from capture_app.common.errors import IncompleteError
from capture_app.net.channel import Channel, connect
from capture_app.node.leader import viewfinders
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.protocol.messages import FromLeader, NodeStream
from capture_app.protocol.orders import (
    CameraHealth,
    DetailRequest,
    PreviewRequest,
    PreviewSeen,
)
from capture_app.protocol.status import NodeDetail, Preview
from capture_app.rig.rig_link import RigLink, Update
from tests.cheap_rig import start_leader
from tests.unit.node.camera.controlled_camera import ControlledCamera, ShownNode
from tests.unit.node.joining import joined
from tests.waiting import time_limit, until

pytestmark = [pytest.mark.usefixtures("open_rig"), pytest.mark.virtual]

NODE = 5
OF_A = DetailRequest(camera="a")
"""The run of the node."""


@pytest.fixture
async def leader(tmp_path: Path) -> AsyncIterator[LeaderNode]:
    async with (
        await start_leader(tmp_path / "sessions") as node,
        joined(node.own_address, ("a", NODE)),
    ):
        yield node


@dataclass
class Picture:
    """One grey level; it counts how often it is asked for."""

    level: int
    asked: list[int] = field(default_factory=list)

    def encode(self) -> bytes:
        raise AssertionError("a preview is no image of a burst")

    @property
    def held_bytes(self) -> int:
        return 0

    def reduced(self, width: int) -> NDArray[np.uint8]:
        self.asked.append(width)
        if self.level < 0:
            raise ValueError("the JPEG is torn")
        return np.full((60, 80, 3), self.level, np.uint8)


class Node(ShownNode):
    """A node whose camera sees grey levels."""

    def __init__(self, name: str = "a", *, is_busy: bool = False) -> None:
        super().__init__(name, NODE, ControlledCamera())
        self.is_busy = is_busy

    def see(self, number: int, level: int = 128) -> Picture:
        picture = Picture(level)
        stamp_ns = 900_000_000 + number * 20_000_000
        self.viewfinder.add_frame(CapturedFrame(number, 0, stamp_ns, picture, exposure_ns=4_000, gain=2.0))
        return picture


async def previews(link: RigLink) -> AsyncGenerator[Preview, None]:
    async for update in link.updates():
        if isinstance(update, Preview):
            yield update


async def first(updates: AsyncIterator[Update], kind: type[Any]) -> Any:
    async with time_limit(f"a {kind.__name__}"):
        async for update in updates:
            if isinstance(update, kind):
                return update
    raise AssertionError("the updates have ended")


async def receive(channel: Channel[Any], kind: type[Any]) -> Any:
    async with time_limit(f"a {kind.__name__}"):
        while (message := await channel.receive_header()) is not None:
            if isinstance(message, kind):
                return message
    raise AssertionError("the leader closed the stream")


async def test_a_preview_goes_from_the_newest_frame_to_the_operator(leader: LeaderNode) -> None:
    node, link = Node(), RigLink(leader.own_address)
    running = asyncio.create_task(node.viewfinder.run())
    try:
        node.viewfinder.set_leader(leader.own_address)
        await link.want_previews(cameras=("a",), width=40, fps=30)
        coming = asyncio.ensure_future(anext(previews(link)))
        await until(lambda: node.viewfinder.request.fps)
        node.see(1)
        picture = node.see(3, level=200)
        node.see(4)
        async with time_limit("the updates that follow"):
            preview = await coming
        assert (preview.camera, preview.width, preview.height) == ("a", 40, 30)
        # Of three instants, the one that all cameras show.
        assert (preview.leader_ns, preview.instant_ns, preview.completes) == (960_000_007, 960_000_000, True)
        decoded = cv2.imdecode(np.frombuffer(preview.jpeg, np.uint8), cv2.IMREAD_COLOR)
        assert decoded.shape == (30, 40, 3)
        assert abs(int(decoded.mean()) - 200) < 3
        assert picture.asked == [40]
        assert (await link.ask(OF_A, NodeDetail)).samples == ((5, 6),)
    finally:
        running.cancel()


async def test_few_previews_are_made_while_frames_are_sent(leader: LeaderNode) -> None:
    """A recording takes minutes, in which a picture that stands still would be called live."""
    node, due_at = Node(is_busy=True), 51  # the 96th instant of 20 ms; a busy camera shows each 48th
    running = asyncio.create_task(node.viewfinder.run())
    try:
        node.viewfinder.set_leader(leader.own_address)
        link = RigLink(leader.own_address)
        seen = [node.see(0)]
        await link.want_previews(cameras=None, width=40, fps=30)
        coming = asyncio.ensure_future(anext(previews(link)))
        await until(lambda: node.viewfinder.request.fps)
        seen += [node.see(number) for number in range(due_at - 47, due_at)]
        await asyncio.sleep(0.05)
        assert not coming.done()
        assert not any(picture.asked for picture in seen), "no picture is made before it is due"
        due = node.see(due_at)
        async with time_limit("the preview of a busy camera"):
            await coming
        assert due.asked
    finally:
        running.cancel()


async def test_a_camera_whose_clock_was_set_back_is_shown_on() -> None:
    node = Node()
    node.grid, node.viewfinder.request = None, PreviewRequest(width=40, fps=10)
    for number in (1000, *range(100)):
        node.see(number)
    assert node.viewfinder._next is not None
    assert node.viewfinder._next[0].sequence > 80


async def test_the_next_preview_waits_until_the_last_was_seen(leader: LeaderNode) -> None:
    async with await connect(leader.own_address, FromLeader) as node:
        await node.send(NodeStream(camera="a", instance=NODE, shows=True))
        updates = RigLink(leader.own_address)
        await updates.want_previews(cameras=None, width=64, fps=5)
        showing = previews(updates)
        coming = asyncio.ensure_future(anext(showing))
        assert (await receive(node, PreviewRequest)).fps == 5
        for number in range(3):
            await node.send(Preview(camera="a", leader_ns=number, width=1, height=1), b"jpeg")
            await receive(node, PreviewSeen)
        # The leader takes what comes and keeps the newest.
        async with time_limit("the updates that follow"):
            assert (await coming).leader_ns in (0, 1, 2)
        await showing.aclose()
        assert (await receive(node, PreviewRequest)).fps == 0, "nobody looks any more"
        # A preview that was under way: the node would else send none to the next who looks.
        await node.send(Preview(camera="a", leader_ns=9, width=1, height=1), b"jpeg")
        await receive(node, PreviewSeen)


async def test_a_node_is_asked_for_what_all_operators_together_want(leader: LeaderNode) -> None:
    async with await connect(leader.own_address, FromLeader) as node:
        await node.send(NodeStream(camera="a", instance=NODE, shows=True))
        small, large = RigLink(leader.own_address), RigLink(leader.own_address)
        await small.want_previews(cameras=None, width=64, fps=4)
        watching = [asyncio.ensure_future(first(link.updates(), Preview)) for link in (small, large)]
        assert (await receive(node, PreviewRequest)).width == 64
        while True:
            # Once it is connected this goes over its stream.
            await large.want_previews(cameras=("a",), width=640, fps=1)
            wanted = await receive(node, PreviewRequest)
            if wanted.width == 640:
                break
        assert wanted.fps == 4
        await large.want_previews(cameras=("b",), width=640, fps=1)
        assert (await receive(node, PreviewRequest)).width == 64
        for task in watching:
            task.cancel()


async def test_details_that_do_not_come_are_an_error(leader: LeaderNode) -> None:
    link = RigLink(leader.own_address)
    with pytest.raises(IncompleteError, match="a has no open stream"):
        await link.ask(OF_A, NodeDetail)
    async with await connect(leader.own_address, FromLeader) as node:
        await node.send(NodeStream(camera="a", instance=NODE, shows=True))
        await node.send(CameraHealth(fps=30.0))
        asked = [asyncio.ensure_future(link.ask(OF_A, NodeDetail)) for _ in range(2)]
        await receive(node, DetailRequest)
        await node.send(NodeDetail(camera="a", spool="/spool"))
        async with time_limit("the updates that follow"):
            assert [(await one).spool for one in asked] == ["/spool", "/spool"]
        gone = asyncio.ensure_future(link.ask(OF_A, NodeDetail))
        await receive(node, DetailRequest)
    with pytest.raises(IncompleteError, match="a has no open stream"):
        await gone


async def test_a_silent_node_is_told_to_all_who_ask(
    leader: LeaderNode, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever asked first gives up first, and must not take the others along."""
    monkeypatch.setattr(viewfinders, "NODE_ANSWER_TIMEOUT_S", 0.5)
    async with await connect(leader.own_address, FromLeader) as node:
        await node.send(NodeStream(camera="a", instance=NODE, shows=True))
        await node.send(CameraHealth(fps=30.0))
        first_one = asyncio.ensure_future(RigLink(leader.own_address).ask(OF_A, NodeDetail))
        await receive(node, DetailRequest)
        await asyncio.sleep(0.2)
        second_one = asyncio.ensure_future(RigLink(leader.own_address).ask(OF_A, NodeDetail))
        async with time_limit("both answers"):
            told = await asyncio.gather(first_one, second_one, return_exceptions=True)
        assert [type(one) for one in told] == [IncompleteError, IncompleteError]


def test_how_a_camera_runs_is_told_from_its_latest_frames() -> None:
    node = Node()
    assert node.viewfinder.health == CameraHealth()
    for number in range(6):
        node.see(number)
    assert node.viewfinder.health == CameraHealth(fps=50.0, exposure_ns=4_000, gain=2.0)


async def test_how_a_camera_runs_is_sent_once_it_has_changed() -> None:
    node, channel = Node(), AsyncMock()
    sending = asyncio.create_task(node.viewfinder._send_health(channel))
    await asyncio.sleep(3.5)
    assert [call.args for call in channel.send.await_args_list] == [(CameraHealth(),)]
    for number in range(6):
        node.see(number)
    await asyncio.sleep(3.0)
    sent = [call.args for call in channel.send.await_args_list[1:]]
    assert sent == [(CameraHealth(fps=50.0, exposure_ns=4_000, gain=2.0),)]
    sending.cancel()


async def test_after_a_picture_that_cannot_be_read_the_next_is_shown() -> None:
    node, channel = Node(), AsyncMock()
    node.viewfinder.request = PreviewRequest(width=80, fps=50)
    node.viewfinder._may_send.set()
    showing = asyncio.create_task(node.viewfinder._show(channel))
    for level in (-1, 77):
        node.see(3, level)
        await asyncio.sleep(0.1)
    ((preview, jpeg),) = (call.args for call in channel.send.await_args_list)
    assert (preview.width, preview.height, preview.leader_ns) == (80, 60, 960_000_007)
    picture = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert abs(int(picture.mean()) - 77) < 3
    node.see(4)
    await asyncio.sleep(0.1)
    assert channel.send.await_count == 1, "the leader has not seen the last one yet"
    showing.cancel()
