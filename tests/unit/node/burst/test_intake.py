"""Images on their way to the disk: in batches, one after the other, and told while they wait."""

import asyncio
import queue
from collections.abc import Sequence
from pathlib import Path

import pytest

from capture_app.common.errors import DiskError, DiskFullError, NetworkError, TryAgainError
from capture_app.node.burst.intake import Intake
from capture_app.protocol.messages import ImageBatch
from capture_app.session.format.manifest import MissingImage
from capture_app.session.writing.image_store import StoredImage
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.sync.rig.frame_selection import Burst
from tests.unit.node.bursts import DISK, IMAGE, PERIOD_NS, burst_session, pieces, report, upload
from tests.waiting import until

S = 1_000_000_000


class SlowWriter(SessionWriter):
    """Syncs when it is let go on; the third sync finds no room."""

    syncs: list[None]
    turns: "queue.Queue[None]"

    def sync(self, *cameras: str) -> None:
        self.syncs.append(None)
        self.turns.get(timeout=10)
        if len(self.syncs) == 3:
            raise DiskFullError("full")
        super().sync(*cameras)


@pytest.fixture(autouse=True)
def turns(monkeypatch: pytest.MonkeyPatch) -> "queue.Queue[None]":
    turns: queue.Queue[None] = queue.Queue()
    monkeypatch.setattr(SlowWriter, "turns", turns, raising=False)
    monkeypatch.setattr(SlowWriter, "syncs", [], raising=False)
    return turns


async def test_images_that_come_during_a_sync_share_the_next(
    tmp_path: Path, turns: "queue.Queue[None]"
) -> None:
    writer = SlowWriter.create(tmp_path, "burst-001")
    burst = Burst(1, range(4), PERIOD_NS, 0, ("a",))
    intake = Intake(writer, DISK, burst, asyncio.Event(), ["a"])

    async def receive(instant: int) -> "asyncio.Future[str]":
        batch = ImageBatch(images=(upload("a", instant),))
        return await intake.receive(batch, pieces(IMAGE), (640, 480))

    first = await receive(0)
    await until(lambda: SlowWriter.syncs)
    others = [await receive(instant) for instant in (1, 2)]
    turns.put(None)
    assert await first == upload("a", 0).sha256
    turns.put(None)
    assert await asyncio.gather(*others) == [upload("a", 1).sha256] * 2
    assert len(SlowWriter.syncs) == 2
    last = await receive(3)
    turns.put(None)
    with pytest.raises(DiskFullError):
        await last
    assert [writer.image("a", n) is not None for n in range(4)] == [True, True, True, False]
    writer.abort()


async def test_nothing_is_written_beside_work_that_needs_the_session_at_rest(
    tmp_path: Path, turns: "queue.Queue[None]"
) -> None:
    writer = SlowWriter.create(tmp_path, "burst-001")
    over = asyncio.Event()
    intake = Intake(writer, DISK, Burst(1, range(4), PERIOD_NS, 0, ("a",)), over, ["a"])
    first = await intake.receive(ImageBatch(images=(upload("a", 0),)), pieces(IMAGE), (640, 480))
    await until(lambda: SlowWriter.syncs)
    is_at_rest, goes_on, saved_before = asyncio.Event(), asyncio.Event(), list[bool]()

    async def rest() -> None:
        async with intake.at_rest():
            saved_before.append(first.done())
            is_at_rest.set()
            await goes_on.wait()
            over.set()

    resting = asyncio.create_task(rest())
    await asyncio.sleep(0)
    assert (is_at_rest.is_set(), intake.is_saving("a")) == (False, True)
    turns.put(None)
    await is_at_rest.wait()
    batch = ImageBatch(images=(upload("a", 1),))
    receiving = asyncio.create_task(intake.receive(batch, pieces(IMAGE), (640, 480)))
    await asyncio.sleep(0)
    goes_on.set()
    with pytest.raises(TryAgainError, match="burst 1 is over"):
        await receiving
    await resting
    assert saved_before == [True]
    assert (intake.is_saving("a"), intake.arrived_bytes("a")) == (False, 2 * len(IMAGE))
    writer.abort()


async def test_more_bytes_than_declared_break_the_stream_off(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path, "burst-001")
    intake = Intake(writer, DISK, Burst(1, range(4), PERIOD_NS, 0, ("a",)), asyncio.Event(), ["a"])
    with pytest.raises(NetworkError, match="a sent more bytes of an image than it declared"):
        await intake.receive(ImageBatch(images=(upload("a", 0),)), pieces(IMAGE + b"x"), (640, 480))
    assert writer.image("a", 0) is None
    writer.abort()


class LosingWriter(SessionWriter):
    """What is appended is gone, as after a sync that failed between an append and its own sync."""

    def append(self, images: Sequence[StoredImage], *, in_videos: bool = False) -> None:
        pass


@pytest.mark.parametrize("is_video", [False, True], ids=["images", "video"])
async def test_what_a_failed_sync_removed_is_not_acknowledged(tmp_path: Path, is_video: bool) -> None:
    writer = LosingWriter.create(tmp_path, "burst-001")
    burst = Burst(1, range(4), PERIOD_NS, 0, ("a",), streamed=is_video, video=is_video)
    intake = Intake(writer, DISK, burst, asyncio.Event(), ["a"])
    saved = await intake.receive(ImageBatch(images=(upload("a", 0),)), pieces(IMAGE), (640, 480))
    with pytest.raises(TryAgainError):
        await saved
    writer.abort()


async def test_a_long_wait_for_the_disk_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, turns: "queue.Queue[None]"
) -> None:
    session = burst_session(tmp_path, "a", "cam03", kind=SlowWriter)
    await session.accept_report(report("a", 0, 1), now_ns=0)
    loop = asyncio.get_running_loop()

    def told_after(seconds: float) -> str:
        real = loop.time
        with monkeypatch.context() as patched:
            patched.setattr(loop, "time", lambda: real() + seconds)
            return session.status.message

    coming = [await session.take(ImageBatch(images=(upload("a", n),)), pieces(IMAGE), 0) for n in range(2)]
    await until(lambda: SlowWriter.syncs)
    assert session.status.message == "", "it has only just begun"
    assert told_after(8.0) == "waiting for the disk: 2 images, 8 s"
    for _ in range(2):
        turns.put(None)
    await asyncio.gather(*coming)
    assert told_after(8.0) == ""
    await session.suspend()


async def test_a_burst_is_finished_as_soon_as_its_last_image_is_saved(tmp_path: Path) -> None:
    """Not when its leader next looks after silent cameras."""
    session = burst_session(tmp_path, "a")
    await session.accept_report(report("a", 0, 1), 0)
    for instant in (0, 1):
        batch = ImageBatch(images=(upload("a", instant),))
        await (await session.take(batch, pieces(IMAGE), 0))
    async with asyncio.timeout(20):
        await session.finished.wait()


async def test_whose_report_is_waited_for_is_told(tmp_path: Path) -> None:
    session = burst_session(tmp_path, "a", "cam03", spare=1)
    assert session.status.message == "", "nobody has told anything yet"
    await session.accept_report(report("a", 0, 1), now_ns=0)
    assert session.status.message == "waiting to hear from cam03"
    await session.suspend()


async def test_whose_pictures_are_waited_for_is_told_a_second_after_the_last_instant(tmp_path: Path) -> None:
    session = burst_session(tmp_path, "a", "cam03")
    last_ns = session.burst.instants_ns[-1]
    await session.give_up_silent_cameras({}, last_ns + S // 2)
    assert session.status.message == ""
    await session.give_up_silent_cameras({}, last_ns + S)
    assert session.status.message == "waiting for images of a, cam03"
    gaps = (MissingImage(camera="a", instant=n, reason="its lens is covered") for n in range(2))
    await session.accept_report(report("a", missing=tuple(gaps)), now_ns=0)
    assert session.status.message == "waiting for images of cam03"
    await session.suspend()


class OneBroken(SessionWriter):
    """Cannot sync the video of b."""

    def sync(self, *cameras: str) -> None:
        if "b" in cameras:
            raise DiskError("its file is gone")
        super().sync(*cameras)


@pytest.mark.virtual
async def test_a_video_that_cannot_be_synced_costs_no_other_camera_a_frame(tmp_path: Path) -> None:
    writer = OneBroken.create(tmp_path, "walk")
    burst = Burst(1, range(4), PERIOD_NS, 0, ("a", "b"), streamed=True, video=True)
    intake = Intake(writer, DISK, burst, asyncio.Event(), ["a", "b"])

    async def receive(name: str, instant: int) -> "asyncio.Future[str]":
        batch = ImageBatch(images=(upload(name, instant),))
        return await intake.receive(batch, pieces(IMAGE), (640, 480))

    # The first round is over, and the next one has both.
    await (await receive("a", 0))
    broken, whole = await receive("b", 1), await receive("a", 1)
    assert await whole == upload("a", 1).sha256
    with pytest.raises(DiskError, match="its file is gone"):
        await broken
    assert writer.has("a", 1)
    assert not writer.has("b", 1)
    writer.abort()


async def test_the_mean_size_is_an_image_s_not_a_batch_s(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path, "burst-001")
    intake = Intake(writer, DISK, Burst(1, range(4), PERIOD_NS, 0, ("a",)), asyncio.Event(), ["a"])
    batch = ImageBatch(images=(upload("a", 0), upload("a", 1)))
    await (await intake.receive(batch, pieces(2 * IMAGE), (640, 480)))
    assert intake.mean_bytes() == {"a": len(IMAGE)}
    writer.abort()
