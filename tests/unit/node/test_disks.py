"""Disks that are full or cannot be written, at the leader and at a node: said by name, and waited out."""

import asyncio
import errno
import os
import subprocess
from collections.abc import AsyncIterator, Iterator, Sequence
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from capture_app.common.errors import DiskError
from capture_app.net.channel import Channel, connect
from capture_app.node.burst.burst_session import BurstSession
from capture_app.node.camera.spool import Spool
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.protocol.messages import (
    BurstRequest,
    FromLeader,
    ImageAck,
    ImageBatch,
    NodeStream,
    Refusal,
    ReportAck,
    SpoolSpace,
    ToLeader,
)
from capture_app.session.files.disk import disk_error
from capture_app.session.reading.reader import Session
from capture_app.session.writing.image_store import StoredImage
from capture_app.session.writing.session_writer import SessionWriter
from tests.cheap_rig import start_leader
from tests.unit.net.echoes import received_from
from tests.unit.node import bursts
from tests.unit.node.camera.uploading import Picture, burst_upload, uploading
from tests.unit.node.joining import joined
from tests.waiting import until

pytestmark = pytest.mark.usefixtures("open_rig")

CAM0 = 7


@contextmanager
def mounted(folder: Path, *options: str) -> Iterator[Path]:
    """A small file system of its own."""
    folder.mkdir(exist_ok=True)
    command = ("mount", "-t", "tmpfs", *options, "tmpfs", str(folder))
    if os.geteuid() or subprocess.run(command, check=False, capture_output=True).returncode:
        pytest.skip("no file system can be mounted here")
    try:
        yield folder
    finally:
        subprocess.run(("umount", "-l", str(folder)), check=True)


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    with mounted(tmp_path / "disk", "-o", "size=12m") as folder:
        yield folder


def fill(folder: Path) -> Path:
    """Leave no room on the disk of a folder."""
    file = folder / "other people's files"
    with file.open("wb", buffering=0) as filling:
        for size in (1 << 20, 1 << 12, 1):
            try:
                while True:
                    filling.write(bytes(size))
            except OSError:
                continue
    return file


async def answer(channel: Channel[Any]) -> Any:
    received = await received_from(channel)
    assert received is not None
    return received[0]


@asynccontextmanager
async def cam0_stream(leader: LeaderNode) -> AsyncIterator[Channel[Any]]:
    async with await connect(leader.own_address, FromLeader) as channel:
        await channel.send(NodeStream(camera="cam0", instance=CAM0))
        assert isinstance(await answer(channel), ReportAck)
        yield channel


async def test_a_leader_whose_disk_is_full_before_the_first_image_says_so_and_goes_on(
    small_disk: Path,
) -> None:
    async with (
        await start_leader(small_disk) as leader,
        joined(leader.own_address, ("cam0", CAM0)),
    ):
        taking = leader.bursts.take(BurstRequest(frames=1, spare=2))
        status = await anext(taking)
        filling = await asyncio.to_thread(fill, small_disk)
        report = replace(bursts.report("cam0", 0, 1, 2), leader=leader.instance, burst=status.burst)
        upload = replace(bursts.upload("cam0", 0), leader=leader.instance, burst=status.burst)
        async with cam0_stream(leader) as channel:
            await channel.send(report)
            refusal = await answer(channel)
            assert isinstance(refusal, Refusal)
            assert refusal.retry
            assert "is full" in (await anext(taking)).message
            await until(lambda: any("is full" in line.text for line in leader.log.after(0)))
            await asyncio.to_thread(filling.unlink)
            await channel.send(report)
            assert (await answer(channel)).requested == (0,)
            await channel.send(ImageBatch(images=(upload,)), bursts.IMAGE)
            assert isinstance(await answer(channel), ImageAck)
        done = [told async for told in taking][-1]
        assert (done.received, done.expected) == (1, 1)
        assert done.session is not None
        assert Session.open(Path(done.session)).manifest.missing == ()
        await until(lambda: any("is usable again" in line.text for line in leader.log.after(0)))


async def test_a_spool_that_cannot_be_written_is_told_and_used_again_when_it_can(tmp_path: Path) -> None:
    told: list[SpoolSpace] = []
    got: list[int] = []

    async def serve(channel: Channel[ToLeader]) -> None:
        while (received := await received_from(channel)) is not None:
            match received[0]:
                case ImageBatch(images=images):
                    got.extend(image.record.instant for image in images)
                    await channel.send(ImageAck(sha256=images[-1].sha256))
                case message:
                    if isinstance(message, SpoolSpace):
                        told.append(message)
                    await channel.send(ReportAck())

    said: list[str] = []
    async with uploading(serve, said, Spool(tmp_path, "a")) as uploader:
        await until(lambda: told)
        assert told[-1].problem == ""
        with mounted(tmp_path / "a", "-o", "ro"):
            uploader.add_burst(burst_upload(Picture(b"0"), Picture(b"1")))
            await until(lambda: len(got) == 2 and told[-1].problem)
            assert "Read-only file system" in told[-1].problem
            assert told[-1].free_bytes > 0, "memory stands in for it"
            assert any("stays in memory" in line for line in said)
        uploader.add_burst(burst_upload(Picture(b"2")))
        await until(lambda: len(got) == 3 and not told[-1].problem)


class FailingWriter(SessionWriter):
    """A session on a disk that fails while `fault` is set."""

    fault = errno.EROFS

    def append(self, images: Sequence[StoredImage], *, in_videos: bool = False) -> None:
        if self.fault:
            raise disk_error(OSError(self.fault, os.strerror(self.fault)), self.folder)
        super().append(images, in_videos=in_videos)


@pytest.mark.parametrize("fault", [errno.EROFS, errno.EIO, errno.ENOSPC])
async def test_what_a_failing_disk_could_not_take_comes_when_it_can(
    tmp_path: Path, fault: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(FailingWriter, "fault", fault)
    session = bursts.burst_session(tmp_path, "a", kind=FailingWriter)
    await session.write_plan(bursts.LEADER)
    await session.accept_report(bursts.report("a", 0, 1), 0)
    with pytest.raises(DiskError) as failure:
        await bursts.receive_image(session, bursts.upload("a", 0), bursts.pieces(bursts.IMAGE))
    refusal = Refusal.of_error(failure.value)
    assert refusal.retry, "the node keeps it and asks again"
    await until(session.finished.is_set)
    assert ("full" if fault == errno.ENOSPC else os.strerror(fault)) in session.message
    again = await asyncio.to_thread(BurstSession.resume, session.folder, 0, bursts.DISK)
    await again.accept_report(bursts.report("a", 0, 1), 0)
    for instant in (0, 1):
        await bursts.receive_image(again, bursts.upload("a", instant), bursts.pieces(bursts.IMAGE))
    assert again.session is not None
    assert Session.open(again.session).manifest.missing == ()


async def test_a_spooled_image_that_cannot_be_read_just_now_is_not_given_up(tmp_path: Path) -> None:
    burst = burst_upload(Picture(b"0"))
    spool = Spool(tmp_path, "a")
    spool.open()
    burst.spooled = spool.create_burst(burst.report)
    image = bursts.upload("a", 0)
    burst.spooled.add([(image, bursts.IMAGE)])
    file = burst.spooled.folder / "000001.film"
    file.unlink()
    assert burst.load([image]) == [None], "it is gone"
    file.symlink_to(file)
    with pytest.raises(DiskError):
        burst.load([image])
    spool.close()
