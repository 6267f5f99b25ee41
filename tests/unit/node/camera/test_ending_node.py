"""A node that ends with frames in its memory: they are in its spool, where its next run finds them."""

import asyncio
import threading
from pathlib import Path

import pytest

from capture_app.net.channel import Channel
from capture_app.node.camera.spool import Spool
from capture_app.protocol.messages import ToLeader
from tests.unit.node.camera.uploading import Picture, burst_upload, further, images, uploading
from tests.waiting import until


@pytest.mark.parametrize("streamed", [False, True])
async def test_a_node_that_ends_moves_the_frames_in_its_memory_to_its_spool(
    tmp_path: Path, streamed: bool
) -> None:
    """Simulated ones that were not rendered yet were lost with their leader, 9,436 of one recording."""
    stored: dict[int, bytes] = {}
    ending = threading.Event()

    class Slow(Picture):
        def encode(self) -> bytes:
            ending.wait(10)
            return super().encode()

    async def serve(channel: Channel[ToLeader]) -> None:
        async for image, payload in images(channel):
            stored[image.record.instant] = payload

    pictures = [Slow(b"zero"), Picture(b"one"), Picture(b"two")]
    async with uploading(serve, [], Spool(tmp_path, "a")) as uploader:
        burst = burst_upload(*pictures)
        burst.streamed = streamed
        uploader.add_burst(burst)
        await until(lambda: uploader._encoding is not None)
        asyncio.get_running_loop().call_later(0.05, ending.set)
    assert not stored
    async with uploading(serve, [], Spool(tmp_path, "a")):
        await until(lambda: not any((tmp_path / "a").iterdir()))
    assert stored == {0: b"zero", 1: b"one", 2: b"two"}
    assert [picture.encoded for picture in pictures] == [1, 1, 1], "what was begun is not done twice"


@pytest.mark.parametrize("waiting", [0, 1])
async def test_a_node_that_ends_leaves_where_a_recording_ended_in_its_spool(
    tmp_path: Path, waiting: int
) -> None:
    """Its last frame is being encoded, or waits for that."""
    begun, ending = threading.Event(), threading.Event()

    class Slow(Picture):
        def encode(self) -> bytes:
            begun.set()
            ending.wait(10)
            return super().encode()

    async def take_nothing(channel: Channel[ToLeader]) -> None:
        async for _ in images(channel):
            pass

    pictures = [Picture(b"zero"), Picture(b""), Slow(b"two"), *[Picture(b"three")] * waiting]
    first, _, *last = burst_upload(*pictures).frames
    async with uploading(take_nothing, [], Spool(tmp_path, "a")) as uploader:
        burst = burst_upload()
        burst.streamed = True
        burst.extend(further(first, over=1))
        uploader.add_burst(burst)
        await until(lambda: burst.spooled is not None)
        uploader.extend_burst(further(last[0], gaps=(1,), over=3))
        await until(begun.is_set)
        uploader.extend_burst(further(*last[1:], over=3 + waiting, ended=True))
        asyncio.get_running_loop().call_later(0.05, ending.set)
    spool = Spool(tmp_path, "a")
    (left,) = spool.open()
    plan = left.read_report().plan
    assert (plan.picked, plan.picking, [gap.first for gap in plan.missing_runs]) == (3 + waiting, False, [1])
    spool.close()
