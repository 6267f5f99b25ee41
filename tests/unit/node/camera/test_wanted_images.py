"""What a node sends of a burst when its leader wants only some of it, or nothing any more."""

import asyncio
import threading
from pathlib import Path

import pytest
from msgspec.structs import replace

from capture_app.net.channel import Channel
from capture_app.node.camera.burst_upload import Upload
from capture_app.node.camera.spool import Spool
from capture_app.protocol.messages import (
    CameraReport,
    ImageAck,
    ImageBatch,
    Refusal,
    ReportAck,
    ToLeader,
)
from capture_app.session.format.manifest import MissingImage
from tests.unit.net.echoes import received_from
from tests.unit.node.camera.uploading import Picture, burst_upload, further, images, uploading
from tests.waiting import TIMEOUT_S, until


def pictures(count: int) -> list[Picture]:
    return [Picture(f"picture {n}".encode()) for n in range(count)]


async def test_only_what_the_leader_wants_is_sent_once_it_is_settled(tmp_path: Path) -> None:
    reports: list[CameraReport] = []
    sent: list[int] = []
    forgotten, done = asyncio.Event(), asyncio.Event()

    def answer(report: CameraReport) -> ReportAck:
        reports.append(report)
        enough = len(report.plan.instants) == 3
        return ReportAck(requested=(0, 3)) if enough else ReportAck(undecided=True)

    async def serve(channel: Channel[ToLeader]) -> None:
        async for image, _ in images(channel, answer):
            sent.append(image.record.instant)
            if len(sent) == 2:
                done.set()

    async with uploading(serve, [], Spool(tmp_path, "a")) as uploader:
        burst = burst_upload(*pictures(2))
        burst.on_commit = forgotten.set
        uploader.add_burst(burst)
        await until(lambda: len(reports) > 1)
        assert not sent, "which are wanted is not known yet"
        assert not forgotten.is_set()
        # Two spare instants are over meanwhile, of which the camera dropped the first.
        gap = MissingImage(camera="a", instant=2, reason="the camera dropped the frame", dropped=True)
        uploader.extend_burst(further(gaps=(2,)))
        uploader.extend_burst(further(burst_upload(*pictures(4)).frames[3]))
        await done.wait()
        await until(lambda: not list((tmp_path / "a").iterdir()))
    assert sent == [0, 3]
    assert forgotten.is_set()
    assert reports[-1].plan.instants == (0, 1, 3)
    assert reports[-1].plan.missing == (gap,)


async def test_images_are_sent_ahead_of_the_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("capture_app.node.camera.burst_upload.BATCH_BYTES", 1)
    came: list[ImageBatch] = []
    done = asyncio.Event()

    async def serve(channel: Channel[ToLeader]) -> None:
        while (received := await received_from(channel)) is not None:
            if not isinstance(received[0], ImageBatch):
                await channel.send(ReportAck())
                continue
            came.append(received[0])
            if len(came) == 5:
                await channel.send(ImageAck())
                for image in came:
                    await channel.send(ImageAck(sha256=image.sha256))
                done.set()

    async with uploading(serve, []) as uploader:
        burst = burst_upload(*pictures(5))
        uploader.add_burst(burst)
        await done.wait()
        await until(lambda: burst.confirmed == {0, 1, 2, 3, 4})
    assert [image.record.instant for batch in came for image in batch.images] == [0, 1, 2, 3, 4]


async def test_a_cancelled_burst_leaves_nothing_in_the_spool(tmp_path: Path) -> None:
    asked = asyncio.Event()

    def undecided(_: CameraReport) -> ReportAck:
        asked.set()
        return ReportAck(undecided=True)

    async def serve(channel: Channel[ToLeader]) -> None:
        async for _ in images(channel, undecided):
            raise AssertionError("nothing is wanted")

    said: list[str] = []
    async with uploading(serve, said, Spool(tmp_path, "a")) as uploader:
        uploader.add_burst(burst_upload(*pictures(3)))
        await asked.wait()
        spooled = tmp_path / "a/00000001-000001"
        index = spooled / "000001.ndjson"
        await until(lambda: index.exists() and index.read_bytes().count(b"\n") == 3)
        uploader.cancel_burst(1, 1)
        await until(lambda: not spooled.exists())
    assert "burst 1 was cancelled" in said


async def test_a_burst_that_was_cancelled_while_the_node_was_away_is_deleted(tmp_path: Path) -> None:
    def refuse(_: CameraReport) -> Refusal:
        return Refusal(what="burst 1 was cancelled", forget=True)

    async def serve(channel: Channel[ToLeader]) -> None:
        async for _ in images(channel, refuse):
            raise AssertionError("nothing is wanted")

    said: list[str] = []
    async with uploading(serve, said, Spool(tmp_path, "a")) as uploader:
        uploader.add_burst(burst_upload(*pictures(1)))
        await until(lambda: any("was cancelled" in line for line in said))
        await until(lambda: not list((tmp_path / "a").iterdir()))


def numbered(burst: int, *shown: Picture) -> Upload:
    upload = burst_upload(*shown)
    upload.report = replace(upload.report, burst=burst)
    return upload


@pytest.mark.parametrize(
    "not_yet",
    [ReportAck(undecided=True), Refusal(what="the leader's disk is full", retry=True)],
    ids=["undecided", "refused for now"],
)
async def test_the_next_burst_does_not_wait_for_one_that_the_leader_cannot_take_yet(
    not_yet: ReportAck | Refusal,
) -> None:
    sent: list[int] = []
    may_come = asyncio.Event()

    def answer(report: CameraReport) -> ReportAck | Refusal:
        return ReportAck() if report.burst > 1 or may_come.is_set() else not_yet

    async def serve(channel: Channel[ToLeader]) -> None:
        async for image, _ in images(channel, answer):
            sent.append(image.burst)

    async with uploading(serve, []) as uploader:
        for number in (1, 2, 3):
            uploader.add_burst(numbered(number, *pictures(2)))
        await until(lambda: sent == [2, 2, 3, 3])
        may_come.set()
        await until(lambda: sent == [2, 2, 3, 3, 1, 1])


async def test_the_leader_hears_of_every_burst_before_it_receives_further_images() -> None:
    came: list[tuple[str, int]] = []

    async def serve(channel: Channel[ToLeader]) -> None:
        while (received := await received_from(channel)) is not None:
            message, _ = received
            if isinstance(message, ImageBatch):
                came.append(("image", message.burst))
                if len(came) == 4:
                    uploader.add_burst(numbered(4, *pictures(1)))
                await channel.send(ImageAck(sha256=message.sha256))
                continue
            if isinstance(message, CameraReport):
                came.append(("report", message.burst))
            await channel.send(ReportAck())

    async with uploading(serve, []) as uploader:
        slow = SlowPicture(b"the last of the first burst")
        uploader.add_burst(numbered(1, *pictures(1), slow))
        for number in (2, 3):
            uploader.add_burst(numbered(number, *pictures(1)))
        await until(lambda: ("report", 4) in came)
        assert came == [*(("report", n) for n in (1, 2, 3)), ("image", 1), ("report", 4)]
        slow.may_end.set()
        await until(lambda: len(came) == 9)
    assert came[5:] == [("image", n) for n in (1, 2, 3, 4)]


class SlowPicture(Picture):
    """A picture that is encoded only when a test says so."""

    def __init__(self, data: bytes) -> None:
        super().__init__(data)
        self.may_end = threading.Event()

    def encode(self) -> bytes:
        self.may_end.wait(TIMEOUT_S)
        return super().encode()


async def test_only_the_leader_that_ordered_a_burst_can_have_it_deleted(tmp_path: Path) -> None:
    slow = SlowPicture(b"picture 1")
    refused = asyncio.Event()

    def refuse(_: CameraReport) -> Refusal:
        refused.set()
        return Refusal(what="burst 1 was cancelled", forget=True)

    async def serve(channel: Channel[ToLeader]) -> None:
        async for _ in images(channel, refuse):
            raise AssertionError("nothing is wanted")

    said: list[str] = []
    async with uploading(serve, said, Spool(tmp_path, "a")) as uploader:
        assert uploader.leader is not None
        uploader.set_leader(uploader.leader, 2)
        uploader.add_burst(burst_upload(*pictures(1), slow))
        await refused.wait()
        await asyncio.sleep(0.1)  # long enough for a node that would not wait for the frame to give it up
        slow.may_end.set()
        await until(lambda: any("its images stay in" in line for line in said))
        assert (tmp_path / "a/00000001-000001/000001.film").read_bytes() == b"picture 0picture 1"
