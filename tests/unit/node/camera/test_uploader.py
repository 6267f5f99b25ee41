"""The uploader against a leader that misbehaves, over real loopback streams."""

import asyncio
import hashlib
import shutil
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import msgspec
import pytest

from capture_app.common.errors import BadInputError, DiskFullError
from capture_app.net.channel import Channel
from capture_app.node.camera.burst_upload import encode_frame
from capture_app.node.camera.spool import Spool, SpoolFolder, free_spool
from capture_app.node.camera.uploader import MAX_IN_FLIGHT, MAX_WAITING_BURSTS, Uploader
from capture_app.protocol.log import Log
from capture_app.protocol.messages import (
    CameraReport,
    ImageAck,
    ImageBatch,
    Refusal,
    ReportAck,
    ToLeader,
)
from tests.unit.net.echoes import received_from
from tests.unit.node.camera.uploading import (
    Picture,
    burst_upload,
    further,
    images,
    receipts_of,
    uploading,
)
from tests.waiting import until

pytestmark = pytest.mark.virtual


def test_an_exposure_begins_at_the_stamp_whatever_moment_is_aligned() -> None:
    """The rig aligns the middle of a row's exposure here, 7 ns after the stamp."""
    burst = burst_upload(Picture(b"0"))
    image, data = encode_frame(burst.report, replace(burst.frames[0], alignment_offset_ns=7))
    assert data == b"0"
    record = image.record
    assert (record.leader_ns, record.alignment_offset_ns, record.exposure_start_ns) == (2000, 7, 1993)


async def test_what_was_not_acknowledged_is_sent_again_and_developed_once() -> None:
    stored: dict[int, bytes] = {}
    done = asyncio.Event()
    streams = 0

    async def serve(channel: Channel[ToLeader]) -> None:
        nonlocal streams
        streams += 1
        mine = 0
        async for image, payload in images(channel, lambda _: receipts_of(stored)):
            mine += 1
            if streams < 3 and mine == 2:
                return  # The leader dies with this image in its hands.
            assert image.record.instant not in stored
            stored[image.record.instant] = payload
            if len(stored) == 4:
                done.set()

    pictures = [Picture(f"picture {n}".encode()) for n in range(4)]
    async with uploading(serve, []) as uploader:
        uploader.add_burst(burst_upload(*pictures))
        await done.wait()
    assert stored == {n: picture.data for n, picture in enumerate(pictures)}
    assert [picture.encoded for picture in pictures] == [1, 1, 1, 1]
    assert streams == 3


async def test_each_loss_is_told_and_at_first_soon_over_once_a_burst_has_come_between() -> None:
    said, streams = list[str](), 0

    async def serve(channel: Channel[ToLeader]) -> None:
        nonlocal streams
        streams += 1
        if streams % 2:
            return  # It is lost.
        async for _ in images(channel, lambda _: ReportAck()):
            pass

    async with uploading(serve, said, retry_s=(0.1, 1000.0)) as uploader:
        for _ in range(2):
            uploader.add_burst(burst_upload(Picture(b"a picture")))
            await until(lambda: not uploader._bursts)
    assert (streams, len([line for line in said if line.startswith("images wait")])) == (4, 2)


async def test_a_path_that_is_blocked_again_is_told_again_and_is_a_problem_until_it_is_free(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """With no burst to send, too: the leader is to know before a take."""
    monkeypatch.setattr("capture_app.node.camera.uploader.SPACE_EVERY_S", 0.01)
    said, is_blocked = list[str](), True

    async def serve(channel: Channel[ToLeader]) -> None:
        if not is_blocked:
            async for _ in images(channel):
                pass

    async with uploading(serve, said, Spool(tmp_path, "a"), retry_s=(0.01,)) as uploader:
        for times in (1, 2):
            is_blocked = True
            await until(lambda: uploader.problem.startswith("its images wait: "))
            assert [line.startswith("images wait: ") for line in said] == [True] * times
            is_blocked = False
            await until(lambda: not uploader.problem)


async def test_an_image_of_which_the_leader_confirms_other_bytes_is_kept_and_sent_again() -> None:
    received = list[bytes]()

    async def serve(channel: Channel[ToLeader]) -> None:
        while (message := await received_from(channel)) is not None:
            if not isinstance(message[0], ImageBatch):
                await channel.send(ReportAck())
                continue
            received.append(message[1])
            others = hashlib.sha256(b"another picture").hexdigest()
            await channel.send(ImageAck(sha256=message[0].sha256 if received[1:] else others))

    said = list[str]()
    async with uploading(serve, said) as uploader:
        uploader.add_burst(burst_upload(Picture(b"a picture")))
        await until(lambda: received[1:] and not uploader.is_busy)
    assert received == [b"a picture", b"a picture"]
    assert said == ["images wait: the leader has another checksum than the image sent"]


async def test_a_path_that_takes_short_messages_only_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """As one that drops large packets: all is ready there, and neither report nor image ever arrives."""
    monkeypatch.setattr("capture_app.node.camera.uploader.UPLOAD_ANSWER_TIMEOUT_S", 0.2)
    lost = asyncio.Event()
    said: list[str] = []

    async def serve(channel: Channel[ToLeader]) -> None:
        async for _ in images(channel):
            await lost.wait()

    async with uploading(serve, said) as uploader:
        uploader.add_burst(burst_upload(Picture(b"0")))
        await until(lambda: said)
        lost.set()
    assert "does not answer" in said[0]
    assert "mtu 1280" in said[0]


async def test_a_frame_that_cannot_be_developed_is_reported_missing() -> None:
    reports: list[CameraReport] = []
    done = asyncio.Event()

    def note(report: CameraReport) -> ReportAck:
        reports.append(report)
        return ReportAck()

    async def serve(channel: Channel[ToLeader]) -> None:
        async for image, _ in images(channel, note):
            if image.record.instant == 2:
                done.set()

    said: list[str] = []
    async with uploading(serve, said) as uploader:
        uploader.add_burst(burst_upload(Picture(b"0"), Picture(b""), Picture(b"2")))
        await done.wait()
    assert reports[-1].plan.instants == (0, 2)
    assert [gap.instant for gap in reports[-1].plan.missing] == [1]
    assert "the film is torn" in reports[-1].plan.missing[0].reason
    assert any("is lost" in line for line in said)


async def test_a_burst_that_the_leader_does_not_want_is_dropped_and_the_next_one_sent() -> None:
    got: asyncio.Queue[int] = asyncio.Queue()

    def refuse_the_old(report: CameraReport) -> ReportAck | Refusal:
        return (
            Refusal(what="burst 1 is not of this leader") if len(report.plan.instants) == 1 else ReportAck()
        )

    async def serve(channel: Channel[ToLeader]) -> None:
        async for image, _ in images(channel, refuse_the_old):
            got.put_nowait(image.record.instant)

    said: list[str] = []
    async with uploading(serve, said) as uploader:
        uploader.add_burst(burst_upload(Picture(b"old")))
        uploader.add_burst(burst_upload(Picture(b"0"), Picture(b"1")))
        assert [await got.get(), await got.get()] == [0, 1]
    assert any("not of this leader" in line for line in said)


async def test_a_spool_keeps_what_the_leader_has_not_confirmed(tmp_path: Path) -> None:
    """A node that is stopped in the middle sends the rest, byte for byte, when it is started again."""
    stored: dict[int, bytes] = {}
    down, done = asyncio.Event(), asyncio.Event()

    async def serve(channel: Channel[ToLeader]) -> None:
        async for image, payload in images(channel, lambda _: receipts_of(stored), down):
            stored[image.record.instant] = payload
            # After the first image it is as if the leader's plug had been pulled.
            (down if len(stored) == 1 else done).set()

    pictures = [Picture(f"picture {n}".encode()) for n in range(3)]
    async with uploading(serve, [], Spool(tmp_path, "a")) as uploader:
        uploader.add_burst(burst_upload(*pictures))
        await down.wait()
        # An image is safe when its line is: its bytes come before it.
        index = tmp_path / "a/00000001-000001/000001.ndjson"
        await until(lambda: index.exists() and index.read_bytes().count(b"\n") == 3)
    down.clear()
    said: list[str] = []
    async with uploading(serve, said, Spool(tmp_path, "a")):
        await done.wait()
        await until(lambda: not any((tmp_path / "a").iterdir()))
    assert stored == {n: picture.data for n, picture in enumerate(pictures)}
    assert [picture.encoded for picture in pictures] == [1, 1, 1]
    assert any("still in" in line for line in said)


async def test_a_recording_goes_on_where_an_earlier_run_of_the_node_left_it(tmp_path: Path) -> None:
    """Its images arrive once each, and nothing of either run is left in the spool."""
    stored: asyncio.Queue[tuple[int, bytes]] = asyncio.Queue()

    async def keep(channel: Channel[ToLeader]) -> None:
        async for image, payload in images(channel):
            await stored.put((image.record.instant, payload))

    spool = Spool(tmp_path, "a")
    spool.open()
    left = burst_upload(Picture(b"zero"))
    burst = spool.create_burst(left.report)
    burst.add([encode_frame(left.report, left.frames[0])])
    spool.close()
    async with uploading(keep, [], Spool(tmp_path, "a")) as uploader:
        again = burst_upload()
        again.streamed = True
        frame = burst_upload(Picture(b""), Picture(b""), Picture(b"two")).frames[2]
        again.extend(further(frame, gaps=(0, 1), over=3, ended=True))
        uploader.add_burst(again)
        assert [await stored.get(), await stored.get()] == [(0, b"zero"), (2, b"two")]
        await until(lambda: not any((tmp_path / "a").iterdir()))
    assert stored.empty()


async def test_what_another_node_of_its_name_leaves_is_sent_while_this_one_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A node that was still ending when its successor started held its spool."""
    stored: dict[int, bytes] = {}

    async def serve(channel: Channel[ToLeader]) -> None:
        async for image, payload in images(channel):
            stored[image.record.instant] = payload

    monkeypatch.setattr("capture_app.node.camera.uploader.SPACE_EVERY_S", 0.1)
    before = Spool(tmp_path, "a")
    before.open()
    left = burst_upload(Picture(b"zero"))
    before.create_burst(left.report).add([encode_frame(left.report, left.frames[0])])
    async with uploading(serve, [], Spool(free_spool(tmp_path, "a"), "a")):
        await asyncio.sleep(0.3)
        assert not stored, "its node still writes it"
        before.close()
        await until(lambda: bool(stored))
        await until(lambda: not any((tmp_path / ".2/a").iterdir()))
    assert stored == {0: b"zero"}
    assert not any((tmp_path / "a").iterdir())


class FullSpool(Spool):
    """A spool on a disk without room."""

    def create_burst(self, report: CameraReport) -> SpoolFolder:
        raise DiskFullError("the disk of /spool is full")


async def test_a_full_spool_is_told_and_memory_takes_its_place(tmp_path: Path) -> None:
    stored: asyncio.Queue[bytes] = asyncio.Queue()

    async def serve(channel: Channel[ToLeader]) -> None:
        async for _, payload in images(channel):
            stored.put_nowait(payload)

    said: list[str] = []
    async with uploading(serve, said, FullSpool(tmp_path, "a")) as uploader:
        uploader.add_burst(burst_upload(Picture(b"0"), Picture(b"1")))
        assert [await stored.get(), await stored.get()] == [b"0", b"1"]
    assert any("stays in memory" in line for line in said)


async def test_a_spool_that_cannot_be_synced_is_told_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_: SpoolFolder) -> None:
        raise DiskFullError("the disk is full")

    async def serve(_: Channel[ToLeader]) -> None:
        await asyncio.sleep(60.0)

    monkeypatch.setattr(SpoolFolder, "sync", fail)
    said = list[str]()
    async with uploading(serve, said, Spool(tmp_path, "a")) as uploader:
        uploader.add_burst(burst_upload(Picture(b"0")))
        await asyncio.sleep(10.0)
    assert len([line for line in said if "stays in memory" in line]) == 1


async def test_a_burst_whose_session_was_removed_is_named_with_what_to_do(tmp_path: Path) -> None:
    async def serve(channel: Channel[ToLeader]) -> None:
        async for _ in images(channel, lambda _: refusal):
            raise AssertionError("nothing is wanted")

    error = BadInputError("burst 1 of that leader has no session in /rig", hint="move its session back there")
    refusal, said = Refusal.of_error(error), list[str]()
    async with uploading(serve, said, Spool(tmp_path, "a")) as uploader:
        uploader.add_burst(burst_upload(Picture(b"0")))
        await until(lambda: said)
        assert uploader.leader is not None
        shutil.rmtree(tmp_path / "a/00000001-000001")
        uploader.set_leader(uploader.leader, 2)
        await until(lambda: len(said) == 2)
        assert not uploader._bursts, "it is offered no more"
    what = "burst 1 given up: burst 1 of that leader has no session in /rig (move its session back there)"
    folder = tmp_path / "a/00000001-000001"
    assert said == [f"{what}; its images stay in {folder}: delete that folder to drop them", what]


async def test_a_burst_whose_session_is_moved_back_is_delivered_by_a_node_that_runs_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its leader does not know the node's images until they are offered again; one refusal is said once."""
    monkeypatch.setattr("capture_app.node.camera.uploader.OFFER_AGAIN_S", 0.01)
    refusals, saved = list[CameraReport](), asyncio.Event()

    def answer(report: CameraReport) -> ReportAck | Refusal:
        if len(refusals) == 3:
            return ReportAck()
        refusals.append(report)
        return Refusal(what="burst 1 of that leader has no session in /rig")

    async def serve(channel: Channel[ToLeader]) -> None:
        async for _, payload in images(channel, answer):
            assert payload == b"0"
            saved.set()

    async with uploading(serve, said := list[str](), Spool(tmp_path, "a")) as uploader:
        uploader.add_burst(burst_upload(Picture(b"0")))
        await saved.wait()
        await until(lambda: not uploader._bursts)
    assert len(said) == 1


async def test_images_that_a_leader_does_not_confirm_are_said_to_wait_before_the_stream_breaks_off(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As on a path that drops TCP, or large packets, for half a minute; they come when it does not."""
    monkeypatch.setattr("capture_app.node.camera.uploader.SAY_AFTER_S", 0.02)
    passes = asyncio.Event()

    async def serve(channel: Channel[ToLeader]) -> None:
        async for _ in images(channel):
            await passes.wait()

    async with uploading(serve, said := list[str]()) as uploader:
        uploader.add_burst(burst_upload(Picture(b"0")))
        await until(lambda: said)
        passes.set()
        await until(lambda: not uploader._bursts)
    (line,) = said
    assert line.startswith("images wait: no answer from 127.0.0.1:")


async def test_the_oldest_of_too_many_bursts_is_given_up_while_the_leader_is_lost() -> None:
    said: list[str] = []
    uploader = Uploader("a", 1, Log(said.append))
    for number in range(MAX_WAITING_BURSTS + 2):
        burst = burst_upload(Picture(b"0"))
        burst.report = msgspec.structs.replace(burst.report, burst=number)
        uploader.add_burst(burst)
    await uploader.aclose()
    assert said == [f"burst {n} given up: the leader was lost for too long" for n in (0, 1)]


async def test_only_the_leader_that_ordered_a_burst_cancels_it() -> None:
    got = asyncio.Event()

    async def serve(channel: Channel[ToLeader]) -> None:
        async for _ in images(channel):
            got.set()

    async with uploading(serve, said := list[str]()) as uploader:
        uploader.add_burst(burst_upload(Picture(b"0")))
        uploader.cancel_burst(leader=2, burst=1)
        await got.wait()
    assert said == []


@pytest.mark.parametrize(
    ("not_yet", "pauses_s"),
    [
        (Refusal(what="the leader's disk is full", retry=True), (0.1, 0.2, 0.4, 0.4)),
        (ReportAck(undecided=True), (0.05, 0.1, 0.2, 0.4, 0.8, 0.8)),
    ],
    ids=["full", "undecided"],
)
async def test_a_leader_that_cannot_take_a_burst_yet_is_asked_with_growing_pauses(
    not_yet: ReportAck | Refusal, pauses_s: Sequence[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("capture_app.node.camera.uploader.REFUSED_S", (0.1, 0.2, 0.4))
    asked_s: list[float] = []

    def answer(_: CameraReport) -> ReportAck | Refusal:
        asked_s.append(asyncio.get_running_loop().time())
        return not_yet

    async def serve(channel: Channel[ToLeader]) -> None:
        async for _ in images(channel, answer):
            raise AssertionError("nothing is wanted")

    async with uploading(serve, []) as uploader:
        burst = burst_upload(Picture(b"0"))
        # The report of a burst whose frame is encoded already does not change meanwhile.
        burst.images |= {0: encode_frame(burst.report, burst.frames.popleft())[0]}
        uploader.add_burst(burst)
        await until(lambda: len(asked_s) > len(pauses_s))
    waited_s = [after - before for before, after in pairwise(asked_s)]
    assert waited_s[: len(pauses_s)] == pytest.approx(pauses_s, rel=0.05, abs=0.03)


@pytest.mark.parametrize(
    ("picture_bytes", "max_bytes", "sent"), [(1, 1 << 20, MAX_IN_FLIGHT), (30, 61, 3)], ids=["count", "bytes"]
)
async def test_images_on_their_way_are_within_their_bounds(
    monkeypatch: pytest.MonkeyPatch, picture_bytes: int, max_bytes: int, sent: int
) -> None:
    monkeypatch.setattr("capture_app.node.camera.burst_upload.BATCH_BYTES", 1)
    monkeypatch.setattr("capture_app.node.camera.uploader.MAX_BYTES_IN_FLIGHT", max_bytes)
    came: list[ImageBatch] = []

    async def serve(channel: Channel[ToLeader]) -> None:
        while (received := await received_from(channel)) is not None:
            if isinstance(received[0], ImageBatch):
                came.append(received[0])
            else:
                await channel.send(ReportAck())

    async with uploading(serve, []) as uploader:
        uploader.add_burst(burst_upload(*(Picture(b"x" * picture_bytes) for _ in range(MAX_IN_FLIGHT + 2))))
        await asyncio.sleep(5)
    assert len(came) == sent
