"""Frames that are sent as they are picked: in bounded memory, beside other bursts, counted to the last."""

import asyncio
from collections import deque
from pathlib import Path

import pytest
from msgspec.structs import replace

from capture_app.common.errors import DamagedImageError
from capture_app.net.channel import Channel
from capture_app.node.burst.plans import check_report
from capture_app.node.camera.burst_upload import NO_SPOOL, TOO_SLOW, Upload, UploadInput, encode_frame
from capture_app.node.camera.spool import Spool, SpoolFolder
from capture_app.protocol.messages import (
    CameraReport,
    ImageAck,
    ImageBatch,
    Refusal,
    ReportAck,
    ToLeader,
)
from capture_app.session.format.burst_plan import MissingRun
from capture_app.sync.rig.frame_selection import Burst
from tests.unit.net.echoes import received_from
from tests.unit.node.camera.uploading import Picture, burst_upload, further, images, uploading
from tests.waiting import until

pytestmark = pytest.mark.virtual


def streamed(burst: int, *pictures: Picture, max_bytes: int = 1 << 20) -> Upload:
    """A burst that is being picked, with these frames so far."""
    whole = burst_upload(*pictures)
    report = replace(whole.report, burst=burst).with_plan(instants=(), picking=True)
    upload = Upload(report, deque(), streamed=True, max_bytes=max_bytes)
    upload.extend(further(*whole.frames, over=len(pictures)))
    return upload


async def deaf(channel: Channel[ToLeader]) -> None:
    """Serve a node, but confirm none of its images."""
    while (received := await received_from(channel)) is not None:
        if not isinstance(received[0], ImageBatch):
            await channel.send(ReportAck())


def test_what_is_missing_is_told_in_runs_at_the_end() -> None:
    upload = streamed(1, Picture(b"zero"))
    assert upload.current_report(tuple(upload.images)).plan.picking
    upload.extend(further(gaps=(1, 2), over=3))
    upload.extend(further(gaps=(4,), over=5))
    upload.report_lost([5], "its file in the spool is damaged")
    told = upload.current_report(tuple(upload.images)).plan
    assert (told.picked, told.missing_runs) == (None, ())
    upload.extend(further(over=6, ended=True))
    told = upload.current_report(tuple(upload.images)).plan
    assert (told.picking, told.picked, told.instants, told.missing) == (False, 6, (), ())
    assert told.missing_runs == (
        MissingRun(first=1, count=2, reason="the camera dropped the frame", dropped=True),
        MissingRun(first=4, count=1, reason="the camera dropped the frame", dropped=True),
        MissingRun(first=5, count=1, reason="its file in the spool is damaged"),
    )


def test_an_image_of_an_earlier_run_that_is_lost_afterwards_is_missing_once() -> None:
    """The leader refused the whole report of a node that was started again, and all its later images."""
    upload = streamed(1)
    upload.extend(further(gaps=(0, 1, 2, 3), over=4))
    for instant in (2, 0, 4):
        upload.report_lost([instant], "its file in the spool is damaged")
    upload.extend(further(over=5, ended=True))
    told = upload.current_report().plan
    assert [(run.first, run.count) for run in told.missing_runs] == [(0, 4), (4, 1)]


def test_frames_that_turn_out_to_be_missing_after_later_ones_are_told_in_order() -> None:
    """The leader refused the whole report of a camera whose frame was lost while it was encoded."""
    upload = streamed(1, *(Picture(b"x") for _ in range(4)))
    upload.extend(further(gaps=(4, 5), over=6))
    for instant in (1, 3, 2):
        upload.report_lost([instant], "its image is damaged: cut off")
    upload.extend(further(over=6, ended=True))
    told = upload.current_report(tuple(upload.images)).plan
    assert [(run.first, run.count) for run in told.missing_runs] == [(1, 2), (3, 1), (4, 2)]
    instants_ns = tuple(range(0, 6 * 33_333_333, 33_333_333))
    burst = Burst(1, instants_ns, 33_333_333, 0, ("a",), streamed=True)
    check_report(told, burst, latest=6)


def test_frames_beyond_the_memory_for_them_are_missing_with_the_reason() -> None:
    upload = streamed(1, *(Picture(b"x" * 100) for _ in range(5)), max_bytes=250)
    assert [frame.instant for frame in upload.frames] == [0, 1]
    upload.spooling = False
    sixth = burst_upload(*[Picture(b"x" * 100)] * 6).frames[5]
    upload.extend(further(sixth, over=6, ended=True))
    assert upload.current_report(tuple(upload.images)).plan.missing_runs == (
        MissingRun(first=2, count=3, reason=TOO_SLOW),
        MissingRun(first=5, count=1, reason=NO_SPOOL),
    )


async def test_frames_are_sent_as_they_come_and_the_end_is_told(tmp_path: Path) -> None:
    reports: list[CameraReport] = []
    sent: list[tuple[int, int]] = []

    async def serve(channel: Channel[ToLeader]) -> None:
        while (received := await received_from(channel)) is not None:
            message, _ = received
            if isinstance(message, ImageBatch):
                sent.extend((message.burst, image.record.instant) for image in message.images)
                await channel.send(ImageAck(sha256=message.sha256))
                continue
            if isinstance(message, CameraReport):
                reports.append(message)
            await channel.send(ReportAck())

    async with uploading(serve, [], Spool(tmp_path, "a")) as uploader:
        upload = streamed(1, Picture(b"zero"), Picture(b"one"))
        uploader.add_burst(upload)
        await until(lambda: sent == [(1, 0), (1, 1)])
        assert [report.plan.picking for report in reports] == [True]
        # Another burst does not wait for the end of this one.
        other = burst_upload(Picture(b"still"))
        other.report = replace(other.report, burst=2)
        uploader.add_burst(other)
        await until(lambda: (2, 0) in sent)
        third = burst_upload(*(Picture(b"%d" % n) for n in range(3))).frames[2]
        uploader.extend_burst(further(third, over=3))
        await until(lambda: (1, 2) in sent)
        await until(lambda: not upload.images)
        uploader.extend_burst(further(gaps=(3,), over=4, ended=True))
        await until(lambda: reports[-1].plan.picked == 4)
        await until(lambda: not list((tmp_path / "a").iterdir()))
    assert reports[-1].plan.missing_runs[0].first == 3
    assert sorted(sent) == [(1, 0), (1, 1), (1, 2), (2, 0)]


async def test_a_recording_does_not_wait_for_another_one_that_goes_on(tmp_path: Path) -> None:
    """Frames of the later one stayed in memory, and died with the node, until the earlier one ended."""
    sent: list[int] = []

    async def serve(channel: Channel[ToLeader]) -> None:
        async for image, _ in images(channel):
            sent.append(image.burst)

    async with uploading(serve, [], Spool(tmp_path, "a")) as uploader:
        frames = burst_upload(*(Picture(b"%d" % n) for n in range(100))).frames
        uploader.add_burst(streamed(1))
        later = streamed(2, Picture(b"zero"))
        uploader.add_burst(later)
        for number in range(100):
            uploader.extend_burst(further(frames[number], over=number + 1))
            await asyncio.sleep(0.03)
        assert sent.count(2) == 1
        assert sent.count(1) > 90


async def test_a_node_that_is_started_again_offers_what_the_spool_has(tmp_path: Path) -> None:
    async with uploading(deaf, [], Spool(tmp_path, "a")) as uploader:
        uploader.add_burst(streamed(1, Picture(b"zero"), Picture(b"one")))
        # An image is safe when its line is: its bytes come before it.
        index = tmp_path / "a/00000001-000001/000001.ndjson"
        await until(lambda: index.exists() and index.read_bytes().count(b"\n") == 2)

    reports: list[CameraReport] = []

    async def serve(channel: Channel[ToLeader]) -> None:
        while (received := await received_from(channel)) is not None:
            message, _ = received
            if isinstance(message, ImageBatch):
                await channel.send(ImageAck(sha256=message.sha256))
                continue
            if isinstance(message, CameraReport):
                reports.append(message)
            await channel.send(ReportAck())

    async with uploading(serve, [], Spool(tmp_path, "a")):
        await until(lambda: not list((tmp_path / "a").iterdir()))
    assert [(report.plan.picking, report.plan.instants) for report in reports] == [(False, (0, 1))]


async def test_a_recording_is_sent_in_parts_and_what_is_damaged_costs_no_other_frame(tmp_path: Path) -> None:
    parts: list[list[int]] = []

    async def serve(channel: Channel[ToLeader]) -> None:
        while (received := await received_from(channel)) is not None:
            message, payload = received
            if not isinstance(message, ImageBatch):
                await channel.send(ReportAck())
                continue
            assert payload == b"".join(b"frame %d" % frame.record.instant for frame in message.images)
            parts.append([frame.record.instant for frame in message.images])
            if 2 in parts[-1]:
                refused = DamagedImageError("its image is damaged: cut off", instants=(2,))
                await channel.send(Refusal.of_error(refused))
            else:
                await channel.send(ImageAck(sha256=message.sha256))

    async with uploading(serve, [], Spool(tmp_path, "a")) as uploader:
        upload = streamed(1, *(Picture(b"frame %d" % n) for n in range(5)))
        uploader.add_burst(upload)
        await until(lambda: not upload.images and not upload.frames)
        assert parts == [[0, 1, 2, 3, 4], [0, 1, 3, 4]]
        assert [run.first for run in upload.missing_runs] == [2]
        uploader.extend_burst(further(over=5, ended=True))
        await until(lambda: not list((tmp_path / "a").iterdir()))


async def test_frames_of_a_recording_wait_in_a_film(tmp_path: Path) -> None:
    folder = tmp_path / "a/00000001-000001"
    async with uploading(deaf, [], Spool(tmp_path, "a")) as uploader:
        upload = streamed(1, Picture(b"zero"), Picture(b"one"))
        uploader.add_burst(upload)
        await until(lambda: len(upload.images) == 2)
        assert (folder / "000001.film").read_bytes() == b"zeroone"
        assert not upload.in_memory
        # The leader does not have them soon, so that they are synced to this disk.
        await until(lambda: not upload.unsynced)

    sent: list[bytes] = []

    async def serve(channel: Channel[ToLeader]) -> None:
        while (received := await received_from(channel)) is not None:
            message, payload = received
            if isinstance(message, ImageBatch):
                sent.append(payload)
            await channel.send(
                ImageAck(sha256=message.sha256) if isinstance(message, ImageBatch) else ReportAck()
            )

    async with uploading(serve, [], Spool(tmp_path, "a")):
        await until(lambda: not list((tmp_path / "a").iterdir()))
    assert sent == [b"zeroone"]


async def test_frames_after_the_end_are_dropped_and_not_reported_as_lost(tmp_path: Path) -> None:
    """A node that was started again, while its operator ended the recording, offered them for ever."""
    spool = Spool(tmp_path, "a")
    spool.open()
    whole = burst_upload(*(Picture(b"%d" % n) for n in range(4)))
    folder = spool.create_burst(streamed(1).current_report())
    folder.add([encode_frame(whole.report, frame) for frame in whole.frames])
    folder.film.close()
    upload = Upload.of_spool(SpoolFolder(folder.folder))
    assert upload.report.plan.instants == (0, 1, 2, 3)
    upload.take(UploadInput.REPORTED)
    upload.commit(None, 2)
    assert ([*upload.images], upload.lost_instants()) == ([0, 1], [])
    spool.close()


async def test_a_node_that_is_started_again_goes_on_with_the_recording_it_left(tmp_path: Path) -> None:
    """Two uploads of it would write into one folder of the spool."""
    before = Spool(tmp_path, "a")
    before.open()
    left = burst_upload(Picture(b"zero"))
    before.create_burst(left.report).add([encode_frame(left.report, left.frames[0])])
    before.close()
    reports: list[CameraReport] = []
    got: dict[int, bytes] = {}

    async def serve(channel: Channel[ToLeader]) -> None:
        async for image, data in images(channel, lambda of: reports.append(of) or ReportAck()):
            got[image.record.instant] = data

    async with uploading(serve, [], Spool(tmp_path, "a")) as uploader:
        uploader.add_burst(streamed(1))
        _, second = burst_upload(Picture(b""), Picture(b"one")).frames
        uploader.extend_burst(further(second, over=2))
        await until(lambda: len(got) == 2)
        assert all(report.plan.picking for report in reports), "it is one upload"
    assert got == {0: b"zero", 1: b"one"}
