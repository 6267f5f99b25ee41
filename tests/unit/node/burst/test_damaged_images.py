"""Images that were damaged before they were sent: missing with the reason, and never acknowledged."""

import hashlib
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from capture_app.common.errors import DamagedImageError
from capture_app.net.channel import Channel
from capture_app.node.burst.burst_session import BurstSession
from capture_app.node.camera.spool import Spool
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.protocol.messages import (
    CameraReport,
    ImageAck,
    ImageBatch,
    Refusal,
    ReportAck,
    ToLeader,
)
from capture_app.session.reading.reader import Session
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.sync.rig.burst_orders import BurstOrder
from capture_app.sync.rig.frame_selection import Burst
from capture_app.trust.trust import Trust
from tests.images import small_jpeg
from tests.unit.net.echoes import received_from
from tests.unit.node.bursts import CAMERA, DISK, IMAGE, INSTANTS_NS, PERIOD_NS, receive_image, report, upload
from tests.unit.node.camera.uploading import Picture, burst_upload, uploading
from tests.unit.node.joining import joined
from tests.unit.node.sealed_nodes import introduced
from tests.unit.node.thieves import bring
from tests.waiting import until

pytestmark = pytest.mark.virtual


async def chunks(data: bytes) -> Any:
    yield data


@pytest.mark.parametrize("is_video", [False, True], ids=["images", "video"])
@pytest.mark.parametrize(
    ("data", "wrong"),
    [
        (b"12345", "not an image"),
        (small_jpeg(b"", 16384, 16384), "16384x16384 pixels, not 640x480"),
        (IMAGE[:-2], "cut off"),
    ],
    ids=["5 bytes", "another size", "cut"],
)
async def test_a_damaged_image_is_missing_with_the_reason(
    tmp_path: Path, data: bytes, wrong: str, is_video: bool
) -> None:
    """It was acknowledged: "all 9 images there", and only `verify` saw it."""
    burst = Burst(1, INSTANTS_NS, PERIOD_NS, INSTANTS_NS[0], ("a",), streamed=is_video, video=is_video)
    session = BurstSession.begin(burst, {"a": CAMERA}, SessionWriter.create(tmp_path, "b"), DISK)
    await session.accept_report(report("a", 0, 1).with_plan(picking=is_video), INSTANTS_NS[-1])
    sent = upload("a", 0)
    record = replace(sent.record, bytes=len(data), sha256=hashlib.sha256(data).hexdigest())
    with pytest.raises(DamagedImageError, match=f"its image is damaged: {wrong}"):
        await session.take(ImageBatch(images=(replace(sent, record=record),)), chunks(data), 0)
    await receive_image(session, upload("a", 1), chunks(IMAGE))
    if is_video:
        await session.finish_now("the leader was stopped")
    manifest = Session.open(session.folder).manifest
    assert [one.instant for one in manifest.images] == [1]
    assert [(gap.instant, gap.reason) for gap in manifest.missing] == [(0, f"its image is damaged: {wrong}")]
    assert session.status.message == f"1 image missing (a: its image is damaged: {wrong})"
    assert not list(session.folder.rglob("*.part"))


async def test_a_burst_ends_whose_last_image_is_damaged_and_whose_camera_says_no_more(
    tmp_path: Path, trust: Trust, leader: LeaderNode
) -> None:
    machine, node = introduced(tmp_path, trust, "machine"), ("cam", 1)
    async with joined(leader.own_address, node, trust=machine):
        session = await leader.bursts.order(BurstOrder(frames=3))
        key = leader.instance, session.burst.number
        answers = await bring(leader.own_address, machine, node, key, range(3), b"12345")
        assert [type(answer) for answer in answers[2:]] == [Refusal] * 3
        assert {(answer.error, answer.retry) for answer in answers[2:]} == {("DamagedImageError", False)}
        await until(session.finished.is_set)
    assert session.status.message == "no image arrived, so no session was made; 3 images missing" + (
        " (cam: its image is damaged: not an image)"
    )


async def test_a_node_reports_a_refused_image_as_missing_and_goes_on(tmp_path: Path) -> None:
    reports: list[CameraReport] = []
    taken: list[int] = []

    async def serve(channel: Channel[ToLeader]) -> None:
        while (received := await received_from(channel)) is not None:
            message, _ = received
            instants = [image.record.instant for image in getattr(message, "images", ())]
            if 1 in instants:
                refused = DamagedImageError("its image is damaged: cut off", instants=(1,))
                await channel.send(Refusal.of_error(refused))
            elif isinstance(message, ImageBatch):
                taken.extend(instants)
                await channel.send(ImageAck(sha256=message.sha256))
            else:
                if isinstance(message, CameraReport):
                    reports.append(message)
                await channel.send(ReportAck())

    said: list[str] = []
    spool = Spool(tmp_path, "a")
    async with uploading(serve, said, spool) as uploader:
        uploader.add_burst(burst_upload(*(Picture(b"%d" % n) for n in range(4))))
        await until(lambda: sorted(taken) == [0, 2, 3] and not uploader._bursts)
        await until(lambda: not any(folder.is_dir() for folder in spool.folder.iterdir()))
    spool.close()
    (gap,) = reports[-1].plan.missing
    assert (gap.instant, gap.reason) == (1, "its image is damaged: cut off")
    assert reports[-1].plan.instants == (0, 2, 3)
    assert said == ["burst 1: instants 1 are lost: its image is damaged: cut off"]
