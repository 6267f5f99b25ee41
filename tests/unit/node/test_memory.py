"""Bytes that one machine can make a leader or a relay hold: one share, however many names it uses."""

import asyncio
import hashlib
import threading
from collections.abc import AsyncIterator, Sequence
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from capture_app.common.errors import BadInputError, NetworkError
from capture_app.common.pairing_codes import Role
from capture_app.net.channel import Channel, connect
from capture_app.node.burst.burst_session import BurstSession
from capture_app.node.leader import viewfinders
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.node.leader.memory_shares import MemoryShares
from capture_app.protocol import messages as wire
from capture_app.protocol import orders
from capture_app.protocol.messages import FromLeader, ImageBatch, NodeStream
from capture_app.protocol.status import Preview
from capture_app.session.writing.image_store import StoredImage
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.sync.rig.burst_orders import BurstOrder
from capture_app.sync.rig.frame_selection import Burst
from capture_app.trust.trust import Trust
from tests.images import small_jpeg
from tests.unit.node.bursts import CAMERA, DISK, IMAGE, INSTANTS_NS, PERIOD_NS, burst_session, report, upload
from tests.unit.node.enrolment.test_below_relays import relays
from tests.unit.node.joining import joined
from tests.unit.node.sealed_nodes import introduced
from tests.unit.node.thieves import ask, image
from tests.unit.node.thieves import report as report_of
from tests.waiting import until

MB = 1_000_000


async def turns(number: int = 20) -> None:
    for _ in range(number):
        await asyncio.sleep(0)


async def test_what_exceeds_a_machines_share_waits_for_its_own_images_alone() -> None:
    shares = MemoryShares(100)
    await shares.take("one", 60)
    waiting = [asyncio.create_task(shares.take("one", 50)) for _ in range(2)]
    await shares.take("other", 500)
    await turns()
    assert [task.done() for task in waiting] == [False, False]
    shares.give_back("other", 500)
    await turns()
    assert [task.done() for task in waiting] == [False, False]
    shares.give_back("one", 60)
    await asyncio.gather(*waiting)


class Endless:
    """A payload without an end, and how much of it was read."""

    def __init__(self) -> None:
        self.read = 0

    async def __aiter__(self) -> AsyncIterator[bytes]:
        while self.read < 100 * len(IMAGE):
            self.read += 5
            yield bytes(5)


@pytest.mark.parametrize("is_video", [False, True], ids=["image", "video"])
async def test_bytes_beyond_the_declared_size_end_the_stream_at_once(tmp_path: Path, is_video: bool) -> None:
    burst = Burst(1, INSTANTS_NS, PERIOD_NS, INSTANTS_NS[0], ("a",), streamed=True, video=is_video)
    session = BurstSession.begin(burst, {"a": CAMERA}, SessionWriter.create(tmp_path, "b"), DISK)
    await session.accept_report(report("a").with_plan(picking=True), 0)
    payload = Endless()
    with pytest.raises(NetworkError, match="a sent more bytes of an image than it declared"):
        await session.take(ImageBatch(images=(upload("a", 0),)), aiter(payload), 0)
    assert payload.read <= len(IMAGE) + 5
    await session.suspend()


async def test_a_size_that_no_image_of_its_camera_has_is_refused_before_its_first_byte(
    tmp_path: Path,
) -> None:
    session = burst_session(tmp_path, "a")
    await session.accept_report(report("a", 0, 1), 0)
    payload, of = Endless(), upload("a", 0)
    huge = replace(of, record=replace(of.record, bytes=60 * MB))
    with pytest.raises(BadInputError, match=r"a sent an image of 60.0 MB, too many for 640x480 pixels"):
        await session.take(ImageBatch(images=(huge,)), aiter(payload), 0)
    assert payload.read == 0
    assert session.status.transfer[0].problem.startswith("a sent an image of 60.0 MB")


async def test_frames_of_one_machine_wait_for_the_disk_in_one_share_of_memory(
    tmp_path: Path, trust: Trust, leader: LeaderNode, monkeypatch: pytest.MonkeyPatch
) -> None:
    """40 names with frames of 60 MB each took 2,599 MB of the leader's memory in 80 s."""
    disk_goes_on = threading.Event()
    append, appending = SessionWriter.append, set[str]()

    def slow(writer: SessionWriter, images: Sequence[StoredImage], *, in_videos: bool = False) -> None:
        appending.add(images[0].record.camera)
        disk_goes_on.wait(60)
        append(writer, images, in_videos=in_videos)

    monkeypatch.setattr(SessionWriter, "append", slow)
    frame = small_jpeg(bytes(100_000))
    leader.service._memory = MemoryShares(3 * len(frame))
    machine, other = (introduced(tmp_path, trust, name) for name in ("machine", "other"))
    names = [f"mine{n}" for n in range(8)]
    async with (
        joined(leader.own_address, *((name, n + 1) for n, name in enumerate(names)), trust=machine),
        joined(leader.own_address, ("cam", 1), trust=other),
        AsyncExitStack() as stack,
    ):
        session = await leader.bursts.order(BurstOrder(frames=30, streamed=True, video=True))
        key = leader.instance, session.burst.number

        async def send(trust: Trust, name: str, instance: int) -> Channel[Any]:
            channel = await connect(leader.own_address, FromLeader, trust=trust)
            await stack.enter_async_context(channel)
            await ask(channel, NodeStream(camera=name, instance=instance))
            said = report_of(name, *key, [0]).with_plan(picking=True)
            assert isinstance(await ask(channel, said), wire.ReportAck)
            await channel.send(image(name, *key, 0, frame), frame)
            return channel

        streams = [await send(machine, name, n + 1) for n, name in enumerate(names)]
        await until(lambda: len(appending) == 3)
        streams.append(await send(other, "cam", 1))
        await until(lambda: "cam" in appending)
        assert len(appending) == 4
        disk_goes_on.set()
        for channel in streams:
            # While the disk is slow, answers without a checksum say that it is waited for.
            while (answer := await channel.receive_header()) == wire.ImageAck():
                pass
            assert isinstance(answer, wire.ImageAck), answer
            assert answer.sha256 == hashlib.sha256(frame).hexdigest()


async def test_a_relay_passes_on_no_payload_of_a_streams_first_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It joined 60 MB of each in memory."""
    payloads: list[int] = []
    send = Channel.send

    async def noted(channel: Channel[Any], message: Any, *parts: bytes, **options: Any) -> None:
        if isinstance(message, Preview):
            payloads.append(sum(map(len, parts)))
        await send(channel, message, *parts, **options)

    monkeypatch.setattr(Channel, "send", noted)
    async with relays(tmp_path, 1) as (_, near, trust):
        machine = introduced(tmp_path, trust, "machine")
        await until(lambda: near._upstream)
        async with await connect(near.address, FromLeader, trust=machine) as channel:
            await ask(channel, Preview(camera="cam0", leader_ns=0, width=1, height=1), bytes(MB))
    assert payloads == [MB, 0]


async def test_a_relay_holds_nothing_of_streams_that_have_ended(tmp_path: Path) -> None:
    async with relays(tmp_path, 1) as (_, near, trust):
        operator = introduced(tmp_path, trust, "operator", Role.OPERATOR)
        await until(lambda: near._upstream)
        for _ in range(3):
            async with await connect(near.address, FromLeader, trust=operator) as channel:
                assert isinstance(await ask(channel, wire.StatusRequest()), wire.StatusAnswer)
                assert len(near._upstream_channels) == 1
            await until(lambda: not near._upstream_channels)


async def test_previews_of_one_machine_have_one_share_of_memory(
    tmp_path: Path, trust: Trust, leader: LeaderNode, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(viewfinders, "MAX_PREVIEW_BYTES_PER_MACHINE", 250_000)
    machine, other = (introduced(tmp_path, trust, name) for name in ("machine", "other"))
    operator = introduced(tmp_path, trust, "operator", Role.OPERATOR)
    mine = [(f"mine{n}", n + 1) for n in range(5)]
    async with (
        joined(leader.own_address, *mine, trust=machine),
        joined(leader.own_address, ("cam", 1), trust=other),
        await connect(leader.own_address, FromLeader, trust=operator) as watching,
        AsyncExitStack() as stack,
    ):
        await watching.send(orders.WatchRequest())
        await watching.send(orders.PreviewRequest(width=160, fps=1.0))
        for (name, instance), who in [*((node, machine) for node in mine), (("cam", 1), other)]:
            channel = await stack.enter_async_context(
                await connect(leader.own_address, FromLeader, trust=who)
            )
            opened = NodeStream(camera=name, instance=instance, shows=True)
            assert isinstance(await ask(channel, opened), orders.PreviewRequest)
            preview = Preview(camera=name, leader_ns=0, width=1, height=1)
            assert isinstance(await ask(channel, preview, bytes(100_000)), orders.PreviewSeen)
        streams = leader.service._viewfinders._streams
        assert sum(len(streams[name].pictures) for name, _ in mine) == 2
        assert len(streams["cam"].pictures) == 1
