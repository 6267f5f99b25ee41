"""Recordings that end early at the leader: what their cameras have recorded on comes when it can."""

import asyncio
import dataclasses
import errno
import functools
import shutil
import threading
import time
from collections.abc import AsyncIterator
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from capture_app.commands.take import require_whole
from capture_app.common.address import Address
from capture_app.common.errors import (
    BadInputError,
    DiskError,
    DiskFullError,
    IncompleteError,
    TryAgainError,
)
from capture_app.common.node_state import NodeState
from capture_app.common.timeouts import (
    AFTER_LAST_INSTANT_NS,
    ALL_DISCONNECTED_NS,
    CAMERA_DISCONNECTED_NS,
    CAMERA_STALLED_NS,
)
from capture_app.machine.repair import repair
from capture_app.node.burst import intake
from capture_app.node.burst.burst_session import BurstSession
from capture_app.node.burst.resumed_bursts import ResumedBursts, interrupted_folders
from capture_app.node.leader.bursts import ActiveBursts
from capture_app.protocol.log import Log
from capture_app.protocol.messages import ImageBatch, ImageUpload
from capture_app.rig.taking import Saved
from capture_app.session.format.burst_plan import MissingRun
from capture_app.session.format.manifest import MANIFEST
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verdict import judge
from capture_app.session.reading.verify import verify
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.sync.phase.frame_grid import FrameGrid
from capture_app.sync.rig.burst_orders import BurstOrder
from capture_app.sync.rig.frame_selection import MAX_STREAMED_FRAMES, MAX_STREAMED_NS, Burst
from capture_app.sync.rig.rig_config import RequestedConfig
from capture_app.sync.wire.datagrams import Heartbeat, Report, TriggerAck
from tests.unit.node.bursts import (
    CAMERA,
    DISK,
    IMAGE,
    INSTANTS_NS,
    LEADER,
    PERIOD_NS,
    burst_session,
    receive_image,
    report,
    upload,
)
from tests.unit.node.leader.test_active_bursts import StillClock, bursts_of, engine_of, triggers_sent
from tests.unit.node.test_disks import fill, small_disk
from tests.waiting import until

__all__ = ["small_disk"]

RECORDING = BurstOrder(frames=30, streamed=True, video=True)


async def begin(session: BurstSession, *cameras: str) -> None:
    for name in cameras:
        await session.accept_report(report(name).with_plan(picking=True), session.burst.instants_ns[0])


FRAME = IMAGE * 400
"""Larger than a block of a disk that is full."""


def frame(camera: str, instant: int) -> ImageUpload:
    of = upload(camera, instant)
    return replace(of, record=replace(of.record, bytes=len(FRAME), sha256=sha256(FRAME).hexdigest()))


async def coming(data: bytes = FRAME) -> AsyncIterator[bytes]:
    yield data


async def bring(session: BurstSession, camera: str, *instants: int) -> None:
    for instant in instants:
        await receive_image(session, frame(camera, instant), coming())


async def deliver_late(root: Path, camera: str, instants: range) -> None:
    """A node brings its last images to a leader that has just been started."""
    late = report(camera, *instants).with_plan(picked=instants.stop)
    resumed = ResumedBursts(root, lambda _: None, DISK)
    assert await resumed.answer_finished(late, "") is None, "it is asked for them"
    session = await resumed.reopen(late, 0)
    await session.accept_report(late, 0)
    await bring(session, camera, *instants)
    assert session.session is not None


def whole(folder: Path) -> Session:
    session = Session.open(folder)
    assert [lie for lie in verify(session) if lie.kind != "unreadable"] == []
    return session


async def test_its_status_says_when_a_recording_has_ended(tmp_path: Path) -> None:
    async with bursts_of(tmp_path, engine_of("a")) as bursts:
        session = await bursts.order(RECORDING)
        await begin(session, "a")
        for after_ns, ended in ((0, False), (1, True)):
            await session.give_up_silent_cameras({}, session.burst.instants_ns[-1] + after_ns)
            assert (session.status.ended, session.status.done) == (ended, False)


@pytest.mark.virtual
async def test_a_recording_goes_on_while_the_leaders_disk_is_full(small_disk: Path) -> None:
    """Its cameras' spools have room, and they bring their images when the disk has, too."""
    engine = engine_of("a", "b")
    async with bursts_of(small_disk, engine) as bursts:
        session = await bursts.order(RECORDING)
        await begin(session, "a", "b")
        await bring(session, "a", 0, 1)
        filling = await asyncio.to_thread(fill, small_disk)
        for _ in range(2):
            with pytest.raises(DiskFullError):
                await bring(session, "a", 2)
        await asyncio.sleep(0.01)
        assert not session.finished.is_set()
        assert "full" in session.status.message
        assert "the cameras keep their images" in session.status.message
        assert not session.burst.frames < RECORDING.frames
        filling.unlink()
        await session.accept_report(report("a", 2).with_plan(picking=True), session.burst.instants_ns[9])
        assert session.status.message == ""
        await bring(session, "a", *range(2, 30))
        await bring(session, "b", *range(30))
        for camera in ("a", "b"):
            await session.accept_report(report(camera).with_plan(picked=30), session.burst.instants_ns[-1])
        await until(session.finished.is_set)
    done = whole(session.folder).manifest
    assert (len(done.burst.instants_ns), done.missing) == (30, ())


@pytest.mark.parametrize("why", ["its disk fails", "a person deletes it"])
async def test_a_recording_goes_on_while_the_leaders_disk_fails_but_not_once_it_is_deleted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, why: str
) -> None:
    is_deleted = why == "a person deletes it"

    def fail(*_: Any, **__: Any) -> None:
        raise DiskError("the disk failed") from (FileNotFoundError() if is_deleted else OSError(errno.EIO))

    engine = engine_of("a")
    async with bursts_of(tmp_path, engine) as bursts:
        session = await bursts.order(RECORDING)
        await begin(session, "a")
        await bring(session, "a", 0, 1)
        triggers_sent(engine)
        monkeypatch.setattr(StillClock, "shown_ns", session.burst.instants_ns[9])
        with monkeypatch.context() as failing:
            failing.setattr(SessionWriter, "append", fail)
            failing.setattr(SessionWriter, "set_plan", fail)
            with pytest.raises(DiskError):
                await bring(session, "a", 2)
            with pytest.raises(DiskError):
                await session.accept_report(
                    report("a", 2).with_plan(picking=True), session.burst.instants_ns[9]
                )
            if not is_deleted:
                assert session.status.message == "the disk failed; the cameras keep their images meanwhile"
        if not is_deleted:
            await bring(session, "a", *range(2, 30))
            await session.accept_report(report("a").with_plan(picked=30), session.burst.instants_ns[-1])
        await until(session.finished.is_set)
        ordered = {trigger.count for trigger in triggers_sent(engine, StillClock.shown_ns)}
        instants = len(whole(session.folder).manifest.burst.instants_ns)
        if is_deleted:
            assert ordered == {instants}, "its cameras have frames until then"
            assert 9 < instants < 30
        else:
            assert (instants, whole(session.folder).manifest.missing) == (30, ())


async def test_a_leader_that_is_stopped_counts_what_its_cameras_have_recorded_until_then(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not only the instants of which an image has arrived; the next run keeps the count."""
    engine = engine_of("a", "b")
    async with bursts_of(tmp_path, engine) as bursts:
        session = await bursts.order(RECORDING)
        await begin(session, "a", "b")
        await bring(session, "a", 0, 1)
        triggers_sent(engine)
        monkeypatch.setattr(StillClock, "shown_ns", session.burst.instants_ns[9])
        bursts.end_all()
        (ordered,) = {trigger.count for trigger in triggers_sent(engine, StillClock.shown_ns)}
        monkeypatch.setattr(StillClock, "shown_ns", session.burst.instants_ns[25])
    assert 9 < ordered < 25, "not until the leader's nodes have ended"
    stopped = whole(session.folder).manifest
    assert (len(stopped.burst.instants_ns), len(stopped.missing)) == (ordered, 2 * ordered - 2)
    assert {gap.reason for gap in stopped.missing} == {"the leader was stopped"}
    await deliver_late(tmp_path, "a", range(2, 5))
    late = whole(session.folder).manifest
    assert (len(late.burst.instants_ns), len(late.images), len(late.missing)) == (ordered, 5, 2 * ordered - 5)


async def test_a_recording_whose_disk_is_full_at_its_end_is_whole_once_there_is_room(
    small_disk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Real threads fill a real disk here, and 57 images would each wait for the next sync.
    monkeypatch.setattr(intake, "SYNC_EVERY_S", 0.001)
    async with bursts_of(small_disk, engine_of("a", "b")) as bursts:
        session = await bursts.order(RECORDING)
        await begin(session, "a", "b")
        await bring(session, "a", 0, 1)
        await bring(session, "b", 0)
        filling = await asyncio.to_thread(fill, small_disk)
        await session.give_up_silent_cameras({}, session.burst.instants_ns[-1] + 1)
        with pytest.raises(DiskFullError):
            await bring(session, "b", 1)
        await until(session.finished.is_set)
        assert session.message.startswith("cut off after 2 of 30 instants")
        cut = whole(session.folder).manifest
        assert {gap.reason for gap in cut.missing} == {"the leader's disk is full"}
        filling.unlink()
    await deliver_late(small_disk, "a", range(2, 30))
    await deliver_late(small_disk, "b", range(1, 30))
    done = whole(session.folder).manifest
    assert (len(done.burst.instants_ns), done.missing) == (30, ())


async def test_a_take_that_ends_with_its_disks_trouble_does_not_call_the_disk_usable(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("capture_app.node.leader.bursts.SILENCE_CHECK_S", 0.001)
    async with bursts_of(tmp_path, engine_of("a")) as bursts:

        def said() -> list[str]:
            return [line.text for line in bursts._options.log.after(0) if "disk" in line.text]

        def is_last(line: str) -> bool:
            return said()[-1:] == [line]

        for trouble in ("its disk failed", "its disk failed again"):
            session = await bursts.order(RECORDING)
            await begin(session, "a")
            await bring(session, "a", 0)
            session.trouble = trouble
            await until(functools.partial(is_last, f"leader: {trouble}"))
            await session.finish_now("cut off")
            await until(lambda: not bursts._bursts)
    assert len(said()) == 2


async def test_a_recording_whose_folder_is_removed_ends_and_acknowledges_nothing_more(tmp_path: Path) -> None:
    async with bursts_of(tmp_path, engine_of("a")) as bursts:
        session = await bursts.order(RECORDING)
        await begin(session, "a")
        await bring(session, "a", 0)
        shutil.rmtree(session.folder)
        with pytest.raises(DiskError):
            await bring(session, "a", 1)
        await until(session.finished.is_set)
        assert "was removed while it was being written" in session.message
        await until(lambda: not bursts._bursts)


@pytest.mark.virtual
async def test_frames_after_the_end_that_an_operator_ordered_are_not_acknowledged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its node learns that it need not send them."""
    async with bursts_of(tmp_path, engine_of("a", "b")) as bursts:
        session = await bursts.order(RECORDING)
        await begin(session, "a", "b")
        monkeypatch.setattr(StillClock, "shown_ns", session.burst.instants_ns[5])
        await bursts.end()
        end = session.burst.frames
        assert 6 < end < 30
        await bring(session, "a", *range(end))
        with pytest.raises(TryAgainError):
            await bring(session, "a", end)
        now_ns = session.burst.instants_ns[-1]
        for camera in ("a", "b"):
            answer = await session.accept_report(report(camera, end).with_plan(picked=end), now_ns)
            assert answer.end == end
        await bring(session, "b", *range(end))
        await until(session.finished.is_set)
    assert len(whole(session.folder).manifest.images) == 2 * end
    late = report("a", end, end + 1).with_plan(picked=end + 2)
    saved = await ResumedBursts(tmp_path, lambda _: None, DISK).answer_finished(late, "")
    assert saved is not None
    assert (saved.end, saved.receipts) == (end, ())


@pytest.mark.parametrize("back", ["both", "one, whose node was started again", "none"])
@pytest.mark.virtual
async def test_a_recording_stays_open_while_all_its_cameras_are_silent(tmp_path: Path, back: str) -> None:
    """An access point that is started again is not the end of a recording."""
    session = recording_of(tmp_path, "a", "b")
    await begin(session, "a", "b")
    for camera in ("a", "b"):
        await bring(session, camera, 0, 1)
    silent_ns = session.burst.instants_ns[0] + CAMERA_DISCONNECTED_NS + AFTER_LAST_INSTANT_NS
    last_ns = silent_ns + 20 * 10**9
    session.burst = replace_instants(session.burst, last_ns)
    for now_ns in (session.burst.instants_ns[0], silent_ns, silent_ns + 10 * 10**9):
        await session.give_up_silent_cameras({}, now_ns)
    assert session.status.message == "waiting for all cameras, 20 s; they keep their pictures"
    assert not session.finished.is_set()
    if back == "none":
        await session.give_up_silent_cameras({}, last_ns + AFTER_LAST_INSTANT_NS + CAMERA_DISCONNECTED_NS)
        assert session.finished.is_set()
        return
    again = report("a", 2).with_plan(picking=back == "both")
    await session.accept_report(again, silent_ns + 11 * 10**9)
    await bring(session, "a", 2)
    await session.give_up_silent_cameras({}, silent_ns + 12 * 10**9)
    assert not session.finished.is_set()
    if back == "both":
        return
    assert session.status.message == "waiting for all cameras, 0 s; they keep their pictures"
    await session.give_up_silent_cameras({}, last_ns)
    assert not session.finished.is_set()
    await session.give_up_silent_cameras({}, last_ns + AFTER_LAST_INSTANT_NS + CAMERA_DISCONNECTED_NS)
    assert session.finished.is_set()


@pytest.mark.virtual
async def test_a_camera_that_was_silent_and_has_brought_all_is_not_waited_for(tmp_path: Path) -> None:
    session = recording_of(tmp_path, "a", frames=1000)
    await begin(session, "a")
    await bring(session, "a", 0, 1)
    first_ns, last_ns = session.burst.instants_ns[0], session.burst.instants_ns[-1]
    for now_ns in (first_ns, first_ns + CAMERA_DISCONNECTED_NS + AFTER_LAST_INSTANT_NS):
        await session.give_up_silent_cameras({}, now_ns)
    assert "waiting for all cameras" in session.status.message
    dropped = MissingRun(first=2, count=998, reason="the camera dropped the frame", dropped=True)
    all_of_it = report("a").with_plan(picked=1000, missing_runs=(dropped,))
    await session.accept_report(all_of_it, last_ns + 1)
    assert session.finished.is_set()
    assert len(whole(session.folder).manifest.missing) == 998


@pytest.mark.virtual
async def test_cameras_that_stay_silent_are_waited_for_an_hour_from_the_last_that_was_heard(
    tmp_path: Path,
) -> None:
    session = recording_of(tmp_path, "a", "b")
    await begin(session, "a", "b")
    for camera in ("a", "b"):
        await bring(session, camera, 0)
    first_ns = session.burst.instants_ns[0]
    session.burst = replace_instants(session.burst, first_ns + 4 * ALL_DISCONNECTED_NS)
    heard_ns = first_ns + ALL_DISCONNECTED_NS // 2
    for now_ns in (first_ns, first_ns + CAMERA_STALLED_NS):
        await session.give_up_silent_cameras({}, now_ns)
    await session.accept_report(report("b").with_plan(picking=True), heard_ns)
    # Of what they have, they may bring the rest in any of these minutes.
    for after_ns, ended in (
        (CAMERA_STALLED_NS, False),
        (ALL_DISCONNECTED_NS - 1, False),
        (ALL_DISCONNECTED_NS, True),
    ):
        await session.give_up_silent_cameras({}, heard_ns + after_ns)
        assert session.finished.is_set() == ended


async def test_the_next_run_waits_for_a_recording_until_its_ordered_end(tmp_path: Path) -> None:
    session = recording_of(tmp_path, "a", "b")
    await session.write_plan(LEADER)
    await begin(session, "a", "b")
    await bring(session, "a", 0)
    first_ns, last_ns = session.burst.instants_ns[0], session.burst.instants_ns[-1]
    await session.suspend()
    async with bursts_of(tmp_path, engine_of("a")) as bursts:
        await until(bursts.resumed.sessions)
        with pytest.raises(BadInputError, match="recording-001 was begun before the leader was restarted"):
            await bursts.end()
        assert bursts.newest is not None
        status = bursts.newest.status
        assert (status.name, status.recording, status.ended) == ("recording-001", True, False)
    begun_ns = first_ns - CAMERA_DISCONNECTED_NS
    again = await asyncio.to_thread(BurstSession.resume, session.folder, begun_ns, DISK)
    await again.give_up_silent_cameras({}, last_ns)
    assert not again.finished.is_set()
    await again.give_up_silent_cameras({}, last_ns + AFTER_LAST_INSTANT_NS + CAMERA_DISCONNECTED_NS)
    assert again.finished.is_set()


@pytest.mark.virtual
async def test_repair_does_not_wait_for_the_ordered_end_of_a_recording(tmp_path: Path) -> None:
    session = recording_of(tmp_path, "a", frames=MAX_STREAMED_NS // PERIOD_NS // 2)
    await session.write_plan(LEADER)
    await begin(session, "a")
    await bring(session, "a", 0)
    await session.suspend()
    async with asyncio.timeout(20):
        await repair(tmp_path, wait_s=0.5, address=Address("127.0.0.1", 0), log=Log())
    assert (session.folder / MANIFEST).exists()


def replace_instants(burst: Burst, last_ns: int) -> Burst:
    """The burst with instants until then."""
    return dataclasses.replace(burst, instants_ns=range(burst.instants_ns[0], last_ns + 1, PERIOD_NS))


def recording_of(
    root: Path, *names: str, kind: type[SessionWriter] = SessionWriter, frames: int = 100
) -> BurstSession:
    instants_ns = range(INSTANTS_NS[0], INSTANTS_NS[0] + frames * PERIOD_NS, PERIOD_NS)
    burst = Burst(1, instants_ns, PERIOD_NS, INSTANTS_NS[0], names, streamed=True, video=True)
    return BurstSession.begin(burst, dict.fromkeys(names, CAMERA), kind.create(root, "recording-001"), DISK)


@pytest.mark.virtual
async def test_a_camera_that_has_more_of_a_recording_than_its_session_is_asked_for_it(tmp_path: Path) -> None:
    session = recording_of(tmp_path, "a", "b")
    await session.write_plan(LEADER)
    await begin(session, "a", "b")
    await bring(session, "a", 0, 1)
    await bring(session, "b", 0, 1)
    await session.finish_now("the leader was stopped")
    assert len(whole(session.folder).manifest.burst.instants_ns) == 2
    await deliver_late(tmp_path, "a", range(2, 5))
    await deliver_late(tmp_path, "b", range(2, 5))
    assert len(whole(session.folder).manifest.images) == 10


@pytest.mark.parametrize("picking", [False, True])
async def test_the_next_run_does_not_wait_for_the_end_of_a_recording_without_an_ordered_one(
    tmp_path: Path, picking: bool
) -> None:
    """That is a month away, and its cameras ended it when they joined the next run."""
    session = recording_of(tmp_path, "a", "b", frames=MAX_STREAMED_NS // PERIOD_NS)
    await session.write_plan(LEADER)
    await begin(session, "a", "b")
    await bring(session, "a", 0, 1)
    await session.suspend()
    now_ns = session.burst.instants_ns[1]
    session = await asyncio.to_thread(BurstSession.resume, session.folder, now_ns, DISK)
    assert session.status.ended, "a key takes anew, and does not end what nobody orders"
    for camera in ("a", "b"):
        session.stream_opened(camera)
    await session.accept_report(report("a", 0, 1).with_plan(picked=2), now_ns)
    # It has announced images, and sends none.
    await session.accept_report(report("b", 0, 1).with_plan(picked=2, picking=picking), now_ns)
    await session.give_up_silent_cameras({}, now_ns + CAMERA_STALLED_NS)
    assert session.finished.is_set()
    assert len(whole(session.folder).manifest.images) == 2


async def test_a_session_that_a_full_disk_refused_is_finished_once_there_is_room(
    small_disk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("capture_app.node.burst.resumed_bursts.DISK_RETRY_S", 0.01)
    async with bursts_of(small_disk, engine_of("a")) as bursts:
        session = await bursts.order(RECORDING)
        await begin(session, "a")
        await bring(session, "a", 0, 1)
        with monkeypatch.context() as refusing:
            refusing.setattr(SessionWriter, "finish", _refuse)
            await session.finish_now("the leader's disk is full")
            assert isinstance(session.failure, DiskFullError)
            assert not (session.folder / MANIFEST).exists()
            filling = await asyncio.to_thread(fill, small_disk)
        filling.unlink()
        await until(lambda: bursts.resumed.sessions() or (session.folder / MANIFEST).exists())
        for resumed in bursts.resumed.sessions():
            await resumed.finish_now("its camera has no more")
        assert len(whole(session.folder).manifest.images) == 2


def _refuse(*_: Any, **__: Any) -> Session:
    raise DiskFullError("the disk is full")


class SlowWriter(SessionWriter):
    """A session on a slow disk: its end waits for the test."""

    ending = threading.Event()
    may_end = threading.Event()

    def finish(self, *arguments: Any, **options: Any) -> Session:
        self.ending.set()
        self.may_end.wait(30)
        return super().finish(*arguments, **options)


async def test_an_image_that_comes_while_the_session_is_written_is_not_confirmed(tmp_path: Path) -> None:
    """Its node would delete the only copy."""
    session = recording_of(tmp_path, "a", kind=SlowWriter)
    await begin(session, "a")
    await bring(session, "a", 0, 1)
    ending = asyncio.create_task(session.finish_now("its disk failed"))
    await until(SlowWriter.ending.is_set)
    late = asyncio.create_task(session.take(ImageBatch(images=(frame("a", 2),)), coming(), 0))
    await asyncio.sleep(0)
    SlowWriter.may_end.set()
    await ending
    with pytest.raises(TryAgainError):
        await (await late)


async def test_a_finished_session_that_is_completed_when_the_leader_stops_or_is_killed_is_written_again(
    tmp_path: Path,
) -> None:
    session = recording_of(tmp_path, "a")
    await session.write_plan(LEADER)
    await begin(session, "a")
    await bring(session, "a", 0)
    await session.finish_now("the leader was stopped")
    late = report("a", 1, 2, 3).with_plan(picked=4)
    for stop in (True, False):
        resumed = ResumedBursts(tmp_path, lambda _: None, DISK)
        again = await resumed.reopen(late, 0)
        await again.accept_report(late, 0)
        await bring(again, "a", 1 if stop else 2)
        if stop:
            await resumed.suspend_all()
        else:
            again._writer.abort()  # as a kill does: the manifest is of before
        assert (session.folder / MANIFEST).exists()
        assert list(interrupted_folders(tmp_path)) == ([] if stop else [session.folder])
    await ResumedBursts(tmp_path, lambda _: None, DISK).resume_all(0)
    assert [image.instant for image in whole(session.folder).manifest.images] == [0, 1, 2]
    await deliver_late(tmp_path, "a", range(3, 4))
    assert list(interrupted_folders(tmp_path)) == []


async def restarted(bursts: ActiveBursts, *, is_ready_again: bool) -> BurstSession:
    """All cameras of a recording are started again at its second instant, and bring what they had taken."""
    session = await bursts.order(RECORDING)
    await begin(session, "a", "b")
    for camera in ("a", "b"):
        await session.accept_report(report(camera, 0, 1), session.burst.instants_ns[2])
        await bring(session, camera, 0, 1)
    assert not session.finished.is_set(), "its order is not over"
    assert session.status.message == "waiting until all cameras are ready again"
    last_ns = session.burst.instants_ns[-1]
    if is_ready_again:
        before = MissingRun(first=0, count=20, reason="its node was not running yet")
        for camera in ("a", "b"):
            again = report(camera).with_plan(picking=True)
            await session.accept_report(again, session.burst.instants_ns[21])
            ended = report(camera, *range(20, 30)).with_plan(picked=30, missing_runs=(before,))
            await session.accept_report(ended, last_ns)
            await bring(session, camera, *range(20, 30))
    else:
        await session.give_up_silent_cameras({}, last_ns)
        assert not session.finished.is_set()
        await session.give_up_silent_cameras({}, last_ns + AFTER_LAST_INSTANT_NS)
    await until(session.finished.is_set)
    return session


@pytest.mark.virtual
async def test_a_recording_whose_cameras_are_all_started_again_goes_on(tmp_path: Path) -> None:
    async with bursts_of(tmp_path, engine_of("a", "b")) as bursts:
        session = await restarted(bursts, is_ready_again=True)
    manifest = whole(session.folder).manifest
    assert (len(manifest.burst.instants_ns), manifest.burst.ordered, len(manifest.images)) == (30, None, 24)
    assert {gap.reason for gap in manifest.missing} == {"its node was not running yet"}
    assert (session.status.received, session.status.expected) == (24, 60)
    headline = judge(manifest).headline
    assert "36 of 60 images missing, of them" not in headline
    assert headline.startswith("poor: 36 of 60 images missing, no camera delivered any from 0.1 to 0.6 s;")


@pytest.mark.virtual
async def test_a_recording_whose_cameras_do_not_become_ready_again_counts_what_was_ordered(
    tmp_path: Path,
) -> None:
    """In its status, in words, in its verdict, and by the exit code of `record`."""
    async with bursts_of(tmp_path, engine_of("a", "b")) as bursts:
        session = await restarted(bursts, is_ready_again=False)
    manifest = whole(session.folder).manifest
    assert (len(manifest.burst.instants_ns), manifest.burst.ordered) == (2, 30)
    verdict = judge(manifest)
    assert (verdict.grade, verdict.images, verdict.expected) == ("poor", 4, 60)
    assert "cut off after 2 of 30 instants, 56 of 60 images missing" in verdict.headline.replace(";", ",")
    status = session.status
    assert (status.instants, status.received, status.expected) == (30, 4, 60)
    assert status.message == "cut off after 2 of 30 instants"
    with pytest.raises(IncompleteError, match="56 of 60 images missing"):
        require_whole(Saved(1, status, verdict), 1.0)


async def test_the_next_run_orders_the_rest_of_a_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From cameras that are ready, and from those that become so, by the clock and the grid of before."""
    session = recording_of(tmp_path, "a", "b")
    await session.write_plan(LEADER - 1, unix_minus_leader_ns=time.time_ns() - session.burst.instants_ns[0])
    await begin(session, "a", "b")
    await session.suspend()
    monkeypatch.setattr(StillClock, "shown_ns", session.burst.instants_ns[1])
    engine = engine_of("a", "b")
    a, b = (engine.roster.members[name] for name in ("a", "b"))
    a.report = replace(a.report, state=NodeState.READY)
    async with bursts_of(tmp_path, engine) as bursts:
        await until(bursts.resumed.sessions)
        (trigger,) = triggers_sent(engine, StillClock.shown_ns)
        assert (trigger.leader, trigger.root, trigger.burst) == (LEADER - 1, LEADER, 1)
        assert (trigger.client, trigger.first_leader_ns) == (a.number, session.burst.instants_ns[0])
        assert trigger.count == 100
        assert engine.grid == FrameGrid(session.burst.instants_ns[0], PERIOD_NS)
        ready = Heartbeat(b.number, Report(state=NodeState.READY))
        engine.receive_message(ready, ("b", 0), StillClock.shown_ns)
        assert {of.client for of in triggers_sent(engine, StillClock.shown_ns)} >= {b.number}
        for member in (a, b):
            ack = TriggerAck(member.number, LEADER - 1, 1)
            engine.receive_message(ack, (member.name, 0), StillClock.shown_ns)
        assert triggers_sent(engine, StillClock.shown_ns + 10**9) == []


@pytest.mark.parametrize("what", ["a recording", "a burst", "of this run", "being closed", "without an end"])
async def test_only_the_rest_of_a_recording_with_an_end_can_be_ordered(tmp_path: Path, what: str) -> None:
    if what == "a burst":
        session = burst_session(tmp_path, "a")
    else:
        session = recording_of(tmp_path, "a", frames=MAX_STREAMED_FRAMES if what == "without an end" else 100)
    await session.write_plan(LEADER - 1, unix_minus_leader_ns=0)
    await session.suspend()
    is_of_this_run, is_closing = what == "of this run", what == "being closed"
    again = BurstSession.resume(session.folder, 0, DISK, is_of_this_run=is_of_this_run, is_closing=is_closing)
    now_ns = session.burst.instants_ns[0]
    assert again.to_continue(now_ns, now_ns) == (LEADER - 1 if what == "a recording" else None)
    await again.suspend()


@pytest.mark.parametrize("what", ["another clock", "another rate", "over"])
async def test_the_rest_of_a_recording_is_not_ordered_by(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    session = recording_of(tmp_path, "a")
    jumped_ns = 60 * 10**9 if what == "another clock" else 0
    difference_ns = time.time_ns() - session.burst.instants_ns[0] + jumped_ns
    await session.write_plan(LEADER - 1, unix_minus_leader_ns=difference_ns)
    await begin(session, "a")
    await session.suspend()
    now_ns = session.burst.instants_ns[-1 if what == "over" else 1]
    monkeypatch.setattr(StillClock, "shown_ns", now_ns)
    engine = engine_of("a")
    if what == "another rate":
        config = dataclasses.replace(engine.config, rig=RequestedConfig(period_ns=40_000_000))
        monkeypatch.setattr(engine, "config", config)
    member = engine.roster.members["a"]
    member.report = replace(member.report, state=NodeState.READY)
    async with bursts_of(tmp_path, engine) as bursts:
        await until(bursts.resumed.sessions)
        assert triggers_sent(engine, now_ns) == []


async def test_a_resumed_recording_ends_by_its_length_where_the_clock_began_anew(tmp_path: Path) -> None:
    """As a leader's does whose machine was started again: its instants are days away."""
    instants_ns = range(10**15, 10**15 + 100 * PERIOD_NS, PERIOD_NS)
    burst = Burst(1, instants_ns, PERIOD_NS, 10**15, ("a",), streamed=True, video=True)
    writer = SessionWriter.create(tmp_path, "recording-001")
    session = BurstSession.begin(burst, {"a": CAMERA}, writer, DISK)
    await session.write_plan(LEADER)
    await begin(session, "a")
    await bring(session, "a", 0)
    await session.suspend()
    again = BurstSession.resume(session.folder, 0, DISK)
    for now_ns in (50 * PERIOD_NS, 100 * PERIOD_NS):
        await again.give_up_silent_cameras({}, now_ns)
        assert (again.status.done, again.status.ended) == (False, now_ns > 99 * PERIOD_NS)
    await again.suspend()
