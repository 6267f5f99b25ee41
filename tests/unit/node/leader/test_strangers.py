"""What a stranger may not do to a camera's pictures, by a leader's own port and by a leader of its own."""

import asyncio
import hashlib
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from capture_app.common.errors import BadInputError, NetworkError
from capture_app.net.channel import Channel, connect
from capture_app.node.burst.burst_session import BurstSession
from capture_app.node.burst.resumed_bursts import ResumedBursts
from capture_app.node.camera.spool import REPORT, Spool
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.node.leader.memory_shares import MemoryShares
from capture_app.protocol.messages import (
    BurstRequest,
    CameraReport,
    FromLeader,
    ImageAck,
    ImageBatch,
    ImageReceipt,
    NodeStream,
    Refusal,
    ReportAck,
    SpoolSpace,
    ToLeader,
)
from capture_app.protocol.pairing_messages import EnrolRequest, PairingMessage, PairingProof
from capture_app.session.format.journal import record_of_line
from capture_app.session.format.manifest import ImageRecord, MissingImage
from capture_app.session.reading.reader import Session
from tests.cheap_rig import start_leader
from tests.unit.net.echoes import received_from
from tests.unit.node import bursts
from tests.unit.node.camera.uploading import Picture, burst_upload, uploading
from tests.unit.node.joining import joined
from tests.waiting import time_limit, until

pytestmark = [pytest.mark.usefixtures("open_rig"), pytest.mark.virtual]

CAM0, UNKNOWN_PEER = 1234567, 666
FORGED = b"another picture"


@asynccontextmanager
async def stream(leader: LeaderNode, camera: str, instance: int) -> AsyncIterator[Channel[Any]]:
    async with await connect(leader.own_address, FromLeader) as channel:
        await channel.send(NodeStream(camera=camera, instance=instance))
        yield channel


async def answer(channel: Channel[Any]) -> Any:
    received = await received_from(channel)
    assert received is not None
    return received[0]


def of_burst(leader: LeaderNode, burst: int, told: Any) -> Any:
    return replace(told, leader=leader.instance, burst=burst)


async def test_the_newest_stream_of_a_camera_is_the_one_that_stays(tmp_path: Path) -> None:
    async with (
        await start_leader(tmp_path) as leader,
        joined(leader.own_address, ("cam0", CAM0)),
        stream(leader, "cam0", CAM0) as first,
    ):
        assert isinstance(await answer(first), ReportAck)
        await first.send(NodeStream(camera="cam0", instance=CAM0))
        assert isinstance(await answer(first), ReportAck), "it may say so again"
        async with stream(leader, "cam0", CAM0) as second:
            assert isinstance(await answer(second), ReportAck)
            with suppress(NetworkError):
                assert await received_from(first) is None


async def test_nobody_speaks_for_another_camera(tmp_path: Path) -> None:
    async with (
        await start_leader(tmp_path) as leader,
        joined(leader.own_address, ("cam0", CAM0), ("stranger", UNKNOWN_PEER)),
    ):
        taking = leader.bursts.take(BurstRequest(frames=1, spare=0))
        burst = (await anext(taking)).burst
        report = of_burst(leader, burst, bursts.report("cam0", 0))
        forged = bursts.upload("cam0", 0)
        sha256 = hashlib.sha256(FORGED).hexdigest()
        record = replace(forged.record, bytes=len(FORGED), sha256=sha256)
        forged = of_burst(leader, burst, replace(forged, record=record))

        async with stream(leader, "cam0", UNKNOWN_PEER) as channel:
            refusal = await answer(channel)
            assert isinstance(refusal, Refusal)
            assert refusal.retry, "a node may be on its way to join"
        async with stream(leader, "stranger", UNKNOWN_PEER) as channel:
            assert isinstance(await answer(channel), ReportAck)
            for message in (report, SpoolSpace(camera="cam0", free_bytes=0, spool="/")):
                await channel.send(message)
                assert "may not send for" in (await answer(channel)).what
            await channel.send(ImageBatch(images=(forged,)), FORGED)
            assert "may not send for" in (await answer(channel)).what
            await channel.send(NodeStream(camera="cam0", instance=UNKNOWN_PEER, shows=True))
            assert isinstance(await answer(channel), Refusal)
        async with await connect(leader.own_address, FromLeader) as channel:
            await channel.send(report)
            assert "may not send for" in (await answer(channel)).what

        async with stream(leader, "cam0", CAM0) as channel:
            assert isinstance(await answer(channel), ReportAck)
            await channel.send(report)
            assert (await answer(channel)).receipts == (), "nothing has been put in its place"
            sent = of_burst(leader, burst, bursts.upload("cam0", 0))
            await channel.send(ImageBatch(images=(sent,)), bursts.IMAGE)
            assert isinstance(await answer(channel), ImageAck)
        async with stream(leader, "stranger", UNKNOWN_PEER) as channel:
            assert isinstance(await answer(channel), ReportAck)
            gap = MissingImage(camera="stranger", instant=0, reason="it has no camera")
            await channel.send(of_burst(leader, burst, bursts.report("stranger", missing=(gap,))))
            assert isinstance(await answer(channel), ReportAck)
        status = [told async for told in taking][-1]
        assert status.session is not None
        session = Session.open(Path(status.session))
        (image,) = session.manifest.images
        assert session.image_file(image).read_bytes() == bursts.IMAGE
        assert leader.status().nodes[0].disk_free_bytes is None


async def test_a_node_that_has_joined_keeps_one_stream_and_not_all_room(tmp_path: Path) -> None:
    async with (
        await start_leader(tmp_path) as leader,
        joined(leader.own_address, ("cam0", CAM0), ("cam1", UNKNOWN_PEER)),
        stream(leader, "cam1", UNKNOWN_PEER) as other,
        stream(leader, "cam0", CAM0) as left,
    ):
        for channel in (other, left):
            assert isinstance(await answer(channel), ReportAck)
        async with stream(leader, "cam0", CAM0) as present:
            assert isinstance(await answer(present), ReportAck)
            async with asyncio.timeout(30):
                with suppress(NetworkError):
                    assert await received_from(left) is None
            for channel, name in ((present, "cam0"), (other, "cam1")):
                await channel.send(SpoolSpace(camera=name, free_bytes=0, spool="/"))
                assert isinstance(await answer(channel), ReportAck)


async def test_an_abandoned_stream_is_closed_whatever_other_cameras_did_meanwhile(tmp_path: Path) -> None:
    async with (
        await start_leader(tmp_path) as leader,
        joined(leader.own_address, ("cam0", CAM0), ("cam1", UNKNOWN_PEER)),
        stream(leader, "cam0", CAM0) as left,
    ):
        assert isinstance(await answer(left), ReportAck)
        async with stream(leader, "cam1", UNKNOWN_PEER) as other:
            assert isinstance(await answer(other), ReportAck)
        await asyncio.sleep(1)
        async with stream(leader, "cam0", CAM0) as present, time_limit("the end of the abandoned stream"):
            assert isinstance(await answer(present), ReportAck)
            with suppress(NetworkError):
                assert await received_from(left) is None


async def test_a_refused_image_takes_no_memory_from_the_next(tmp_path: Path) -> None:
    async with (
        await start_leader(tmp_path) as leader,
        joined(leader.own_address, ("cam0", CAM0)),
        stream(leader, "cam0", CAM0) as channel,
        time_limit("the image in place of a damaged one"),
    ):
        leader.service._memory = MemoryShares(len(bursts.IMAGE))
        assert isinstance(await answer(channel), ReportAck)
        taking = leader.bursts.take(BurstRequest(frames=1, spare=0))
        burst = (await anext(taking)).burst
        await channel.send(of_burst(leader, burst, bursts.report("cam0", 0)))
        assert isinstance(await answer(channel), ReportAck)
        batch = ImageBatch(images=(of_burst(leader, burst, bursts.upload("cam0", 0)),))
        await channel.send(batch, bytes(len(bursts.IMAGE)))
        refusal = await answer(channel)
        assert isinstance(refusal, Refusal)
        assert "arrived damaged" in refusal.what
        await channel.send(batch, bursts.IMAGE)
        assert await answer(channel) == ImageAck(sha256=batch.sha256)
        await taking.aclose()


async def test_a_node_deletes_only_what_the_leader_has_as_it_is(tmp_path: Path) -> None:
    stored: dict[int, str] = {1: hashlib.sha256(b"not its picture").hexdigest()}

    async def serve(channel: Channel[ToLeader]) -> None:
        while (received := await received_from(channel)) is not None:
            match received[0]:
                case CameraReport():
                    told = (ImageReceipt(instant=n, sha256=of) for n, of in stored.items())
                    await channel.send(ReportAck(receipts=tuple(told)))
                case ImageBatch(images=images):
                    sent = {image.record.instant: image.sha256 for image in images}
                    if any(stored.get(n, of) != of for n, of in sent.items()):
                        await channel.send(Refusal(what="another image was sent before", retry=True))
                    else:
                        stored.update(sent)
                        await channel.send(ImageAck(sha256=images[-1].sha256))
                case _:
                    await channel.send(ReportAck())

    said: list[str] = []
    folder = tmp_path / "a/00000001-000001"
    async with uploading(serve, said, Spool(tmp_path, "a")) as uploader:
        uploader.add_burst(burst_upload(Picture(b"0"), Picture(b"1"), Picture(b"2")))
        await until(lambda: any("different images" in line for line in said))
        assert stored[0] == hashlib.sha256(b"0").hexdigest()
        assert (folder / "000001.film").read_bytes() == b"012"
        assert any(str(folder) in line for line in said)
        # Another leader, or this one when it has thought better of it, still gets it.
        del stored[1]
        assert uploader.leader is not None
        uploader.set_leader(uploader.leader)
        await until(lambda: not folder.exists())
        assert stored[1] == hashlib.sha256(b"1").hexdigest()


async def finished_session(root: Path, *brought: str) -> BurstSession:
    session = bursts.burst_session(root, "a", "b")
    await session.write_plan(bursts.LEADER)
    for name in brought:
        await session.accept_report(bursts.report(name, 0, 1), 0)
        for instant in (0, 1):
            await bursts.receive_image(session, bursts.upload(name, instant), bursts.pieces(bursts.IMAGE))
    await session.finish_now("it never came")
    return session


def contents(folder: Path) -> dict[Path, tuple[bytes, int]]:
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in files}


async def test_a_report_leaves_a_finished_session_as_it_is(tmp_path: Path) -> None:
    session = await finished_session(tmp_path, "a", "b")
    before = contents(session.folder)
    resumed = ResumedBursts(tmp_path, lambda _: None, bursts.DISK)
    lie = bursts.report("a", missing=())
    told = await resumed.answer_finished(lie.with_plan(camera=replace(lie.plan.camera, facts=ODD)), "")
    assert told is not None
    assert [of.instant for of in told.receipts] == [0, 1]
    assert {of.sha256 for of in told.receipts} == {hashlib.sha256(bursts.IMAGE).hexdigest()}
    assert resumed.sessions() == ()
    assert contents(session.folder) == before
    assert await resumed.answer_finished(replace(lie, burst=9), "") is None


async def test_a_late_report_changes_only_what_was_missing_of_its_camera(tmp_path: Path) -> None:
    session = await finished_session(tmp_path, "a")
    first = {camera.name: camera for camera in Session.open(session.folder).manifest.cameras}
    resumed = ResumedBursts(tmp_path, lambda _: None, bursts.DISK)
    told = bursts.report("b", 0, 1)
    assert await resumed.answer_finished(told, "") is None, "it lacks them"
    late = await resumed.reopen(told, 0)
    await late.accept_report(told, 0)
    odd = bursts.report("a", 0, 1)
    await late.accept_report(odd.with_plan(camera=replace(odd.plan.camera, facts=ODD)), 0)
    for instant in (0, 1):
        await bursts.receive_image(late, bursts.upload("b", instant), bursts.pieces(bursts.IMAGE))
    manifest = Session.open(session.folder).manifest
    assert (len(manifest.images), manifest.missing) == (4, ())
    assert {camera.name: camera for camera in manifest.cameras} == first
    with pytest.raises(BadInputError):
        Session.open(session.folder).camera("stranger")


ODD = replace(bursts.CAMERA, model="Stranger")


DEEP = b'{"x":' + b"[" * 100_000


def test_a_line_that_is_nested_too_deeply_is_a_damaged_one(tmp_path: Path) -> None:
    assert record_of_line(DEEP, ImageRecord) is None
    spool = Spool(tmp_path, "a")
    assert spool.open() == []
    burst = spool.create_burst(bursts.report("a", 0, 1))
    burst.add([(bursts.upload("a", 0), bursts.IMAGE)])
    with (burst.folder / "000001.ndjson").open("ab") as journal:
        journal.write(DEEP + b"\n")
    assert [image.record.instant for image in burst.film.recover()] == [0]
    (burst.folder / REPORT).write_bytes(DEEP)
    with pytest.raises(BadInputError, match=REPORT):
        burst.read_report()
    spool.close()


async def test_nobody_is_made_known_to_an_open_rig_and_is_told_so(tmp_path: Path) -> None:
    async with await start_leader(tmp_path) as leader:
        for message in (
            PairingMessage(certificate=b"x", name="x", spake2_message=b"x"),
            PairingProof(proof=b"x"),
            EnrolRequest(certificate=b"x"),
        ):
            async with await connect(leader.own_address, FromLeader) as channel:
                await channel.send(message)
                assert isinstance(await answer(channel), Refusal), message
