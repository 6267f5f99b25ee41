"""The uploader against a leader that misbehaves, over real loopback streams."""

import asyncio
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass

import pytest

from capture_app.cameras.base import CapturedFrame
from capture_app.net.address import Address
from capture_app.net.transfer import Channel, TransferServer, bind
from capture_app.node import uploader as uploader_module
from capture_app.node.bursts import record_of
from capture_app.node.messages import CameraReport, ImageUpload, Noted, Refusal, Stored, ToLeader
from capture_app.node.uploader import Uploader
from capture_app.node.work import BurstWork
from capture_app.sync.messages import CameraDescription
from capture_app.sync.trigger import Pick

CAMERA = CameraDescription(
    kind="sim",
    model="Simulated",
    width=640,
    height=480,
    period_ns=33_333_333,
    phase_control="injection",
    timestamp_source="start-of-exposure",
)


@dataclass
class Picture:
    data: bytes
    developed: int = 0

    def encode(self) -> bytes:
        self.developed += 1
        if not self.data:
            raise RuntimeError("the film is torn")
        return self.data


def work(*pictures: Picture) -> BurstWork:
    picks = [
        Pick(n, 1000 + n, 2000 + n, 3, 4, 5, 0, CapturedFrame(n, 0, 1000 + n, picture))
        for n, picture in enumerate(pictures)
    ]
    report = CameraReport(leader=1, burst=1, camera=record_of("a", CAMERA), instants=tuple(range(len(picks))))
    return BurstWork(report, deque(picks))


Serve = Callable[[Channel[ToLeader]], Awaitable[None]]


@asynccontextmanager
async def uploading(serve: Serve, said: list[str]) -> AsyncIterator[Uploader]:
    datagrams, listening = bind("127.0.0.1", 0)
    datagrams.close()
    server: TransferServer[ToLeader] = TransferServer(ToLeader, serve)
    await server.start(listening)
    uploader = Uploader(said.append)
    uploader.leader_found(Address("127.0.0.1", listening.getsockname()[1]))
    task = asyncio.create_task(uploader.run())
    try:
        yield uploader
    finally:
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task
        await server.stop()


@pytest.fixture(autouse=True)
def no_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(uploader_module, "RETRY_S", (0.0,))


async def test_what_was_not_acknowledged_is_sent_again_and_developed_once() -> None:
    stored: list[bytes] = []
    done = asyncio.Event()
    streams = 0

    async def serve(channel: Channel[ToLeader]) -> None:
        nonlocal streams
        streams += 1
        mine = 0
        while (received := await channel.receive()) is not None:
            message, payload = received
            if isinstance(message, CameraReport):
                await channel.send(Noted())
            elif isinstance(message, ImageUpload):
                mine += 1
                if streams < 3 and mine == 2:
                    return  # The leader dies with this image in its hands.
                stored.append(payload)
                await channel.send(Stored(sha256=message.record.sha256))
                if len(stored) == 4:
                    done.set()

    pictures = [Picture(f"picture {n}".encode()) for n in range(4)]
    async with uploading(serve, []) as uploader:
        uploader.add(work(*pictures))
        await done.wait()
    assert stored == [picture.data for picture in pictures]
    assert [picture.developed for picture in pictures] == [1, 1, 1, 1]
    assert streams == 3


async def test_a_frame_that_cannot_be_developed_is_reported_missing() -> None:
    reports: list[CameraReport] = []
    done = asyncio.Event()

    async def serve(channel: Channel[ToLeader]) -> None:
        while (received := await channel.receive()) is not None:
            message, _ = received
            if isinstance(message, CameraReport):
                reports.append(message)
                await channel.send(Noted())
            elif isinstance(message, ImageUpload):
                await channel.send(Stored(sha256=message.record.sha256))
                if message.record.instant == 2:
                    done.set()

    said: list[str] = []
    async with uploading(serve, said) as uploader:
        uploader.add(work(Picture(b"0"), Picture(b""), Picture(b"2")))
        await done.wait()
    assert reports[-1].instants == (0, 2)
    assert [gap.instant for gap in reports[-1].missing] == [1]
    assert "the film is torn" in reports[-1].missing[0].reason
    assert any("is lost" in line for line in said)


async def test_a_burst_that_the_leader_does_not_want_is_dropped_and_the_next_one_sent() -> None:
    got: asyncio.Queue[int] = asyncio.Queue()

    async def serve(channel: Channel[ToLeader]) -> None:
        while (received := await channel.receive()) is not None:
            message, _ = received
            if isinstance(message, CameraReport) and len(message.instants) == 1:
                await channel.send(Refusal(what="burst 1 is not of this leader"))
            elif isinstance(message, CameraReport):
                await channel.send(Noted())
            elif isinstance(message, ImageUpload):
                got.put_nowait(message.record.instant)
                await channel.send(Stored(sha256=message.record.sha256))

    said: list[str] = []
    async with uploading(serve, said) as uploader:
        uploader.add(work(Picture(b"old")))
        uploader.add(work(Picture(b"0"), Picture(b"1")))
        assert [await got.get(), await got.get()] == [0, 1]
    assert any("not of this leader" in line for line in said)
