"""Bursts of earlier runs, images that come late, streams that break off, and disks without room."""

import asyncio
import errno
import hashlib
import os
from collections.abc import AsyncIterator
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest

from capture_app.common.address import Address
from capture_app.common.errors import BadInputError, DiskError, DiskFullError, NetworkError, TryAgainError
from capture_app.common.timeouts import DISK_RETRY_S, RETURN_NS
from capture_app.machine.repair import repair
from capture_app.node.burst import resumed_bursts
from capture_app.node.burst.burst_session import BurstSession
from capture_app.node.burst.resumed_bursts import ResumedBursts, interrupted_folders
from capture_app.node.camera.spool import Spool
from capture_app.protocol.log import Log
from capture_app.session.files.disk import SPARE_BYTES
from capture_app.session.format.manifest import MissingImage
from capture_app.session.reading.reader import Session, writing_state
from capture_app.session.reading.verify import verify
from tests.unit.node.bursts import (
    CAMERA,
    DISK,
    IMAGE,
    LEADER,
    burst_session,
    pieces,
    receive_image,
    report,
    upload,
)

pytestmark = pytest.mark.virtual


async def begun_session(root: Path, *names: str) -> BurstSession:
    session = burst_session(root, *names)
    await session.write_plan(LEADER)
    return session


async def breaking_off(data: bytes) -> AsyncIterator[bytes]:
    async for piece in pieces(data):
        yield piece
    raise NetworkError("the connection broke off")


def lies(session: Session) -> list[str]:
    return [str(lie) for lie in verify(session) if lie.kind != "unreadable"]


async def test_after_a_broken_stream_an_image_comes_again(tmp_path: Path) -> None:
    session = await begun_session(tmp_path, "a")
    assert (await session.accept_report(report("a", 0, 1), 0)).receipts == ()
    with pytest.raises(NetworkError):
        await receive_image(session, upload("a", 0), breaking_off(IMAGE[:10]))
    # The leader is killed too.
    await session.suspend()
    session = await asyncio.to_thread(BurstSession.resume, session.folder, 0, DISK)
    assert (await session.accept_report(report("a", 0, 1), 0)).receipts == ()
    await receive_image(session, upload("a", 0), pieces(IMAGE))
    (receipt,) = (await session.accept_report(report("a", 0, 1), 0)).receipts
    assert (receipt.instant, receipt.sha256) == (0, hashlib.sha256(IMAGE).hexdigest())
    await receive_image(session, upload("a", 1), pieces(IMAGE))
    assert session.session is not None
    opened = Session.open(session.session)
    assert lies(opened) == []
    assert [opened.image_file(image).read_bytes() for image in opened.manifest.images] == [IMAGE, IMAGE]
    assert not (opened.folder / "incoming").exists()


async def test_a_stream_that_leaves_out_or_changes_bytes_is_told_to_try_again(tmp_path: Path) -> None:
    session = await begun_session(tmp_path, "a")
    await session.accept_report(report("a", 0, 1), 0)
    with pytest.raises(TryAgainError, match="damaged"):
        await receive_image(session, upload("a", 0), pieces(IMAGE[7:]))
    with pytest.raises(TryAgainError, match="damaged"):
        await receive_image(session, upload("a", 0), pieces(IMAGE[:-1] + b"?"))
    assert (await session.accept_report(report("a", 0, 1), 0)).receipts == (), "nothing of it is kept"
    await session.suspend()


async def test_unreadable_folders_hide_no_other_interrupted_session(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = await begun_session(tmp_path, "a")
    await first.suspend()
    lost = first.folder.rename(tmp_path / "a-lost-one")
    session = await begun_session(tmp_path, "b")
    await session.suspend()

    def state(folder: Path) -> str:
        if folder == lost:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return writing_state(folder)

    monkeypatch.setattr(resumed_bursts, "writing_state", state)
    assert list(interrupted_folders(tmp_path)) == [session.folder]
    too_long = tmp_path / ("x" * 300)
    assert list(interrupted_folders(too_long)) == [], "a leader starts all the same, and says so"


async def test_nodes_have_their_time_to_return_to_what_was_interrupted(tmp_path: Path) -> None:
    session = await begun_session(tmp_path, "a")
    await session.accept_report(report("a", 0, 1), 0)
    await receive_image(session, upload("a", 0), pieces(IMAGE))
    await session.suspend()
    resumed = ResumedBursts(tmp_path, lambda _: None, DISK)
    await resumed.resume_all(0)
    (again,) = resumed.sessions()
    for now_ns, is_given_up in ((RETURN_NS - 1, False), (RETURN_NS, True)):
        await again.give_up_silent_cameras({}, now_ns)
        assert again.status.done is is_given_up


async def test_the_next_run_takes_up_what_was_interrupted_and_what_comes_late(tmp_path: Path) -> None:
    session = await begun_session(tmp_path, "a", "b")
    await session.accept_report(report("a", 0, 1), 0)
    await receive_image(session, upload("a", 0), pieces(IMAGE))
    await session.suspend()
    assert list(interrupted_folders(tmp_path)) == [session.folder]

    taken_up: list[BurstSession] = []
    resumed = ResumedBursts(tmp_path, taken_up.append, DISK)
    await resumed.resume_all(0)
    (again,) = resumed.sessions()
    assert list(interrupted_folders(tmp_path)) == [], "it is locked"
    await receive_image(again, upload("a", 1), pieces(IMAGE))
    await again.finish_now("the rest never came")
    assert len(Session.open(session.folder).manifest.missing) == 2
    before = {path: path.read_bytes() for path in session.folder.glob("images/**/*.jpg")}

    # A week later the other node is found, with its spool.
    other = ResumedBursts(tmp_path, taken_up.append, DISK)
    late = await other.reopen(report("b", 0, 1), 0)
    await late.accept_report(report("b", 0, 1), 0)
    for instant in (0, 1):
        await receive_image(late, upload("b", instant), pieces(IMAGE))
    whole = Session.open(session.folder)
    assert lies(whole) == []
    assert (len(whole.manifest.images), whole.manifest.missing) == (4, ())
    assert {path: path.read_bytes() for path in before} == before
    stranger = msgspec.structs.replace(report("b", 0, 1), leader=1)
    with pytest.raises(BadInputError, match="no session"):
        await other.reopen(stranger, 0)


async def test_a_finished_session_answers_under_its_new_name_and_not_who_still_films(tmp_path: Path) -> None:
    session = await begun_session(tmp_path, "a")
    whole = report("a", 0, 1)
    await session.accept_report(whole, 0)
    for instant in (0, 1):
        await receive_image(session, upload("a", instant), pieces(IMAGE))
    await session.finish_now("it is whole")
    resumed = ResumedBursts(tmp_path, lambda _: None, DISK)
    assert await resumed.answer_finished(whole, "") is not None
    session.folder.rename(tmp_path / "renamed")
    assert await resumed.answer_finished(whole, "") is not None
    filming = msgspec.structs.replace(whole, plan=msgspec.structs.replace(whole.plan, picking=True))
    assert await resumed.answer_finished(filming, "") is None


async def test_a_session_without_room_on_its_disk_is_not_opened_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It could not be finished again, and would have lost its manifest."""
    session = await begun_session(tmp_path, "a", "b")
    await session.accept_report(report("a", 0, 1), 0)
    await receive_image(session, upload("a", 0), pieces(IMAGE))
    resumed = ResumedBursts(tmp_path, lambda _: None, DISK)
    await session.finish_now("the rest never came")
    with monkeypatch.context() as patched:
        patched.setattr(resumed_bursts, "free_bytes", lambda _: SPARE_BYTES - 1)
        with pytest.raises(DiskFullError, match="is full"):
            await resumed.reopen(report("b", 0, 1), 0)
        assert resumed.sessions() == ()
        patched.setattr(resumed_bursts, "free_bytes", lambda _: SPARE_BYTES)
        late = await resumed.reopen(report("b", 0, 1), 0)
    assert resumed.sessions() == (late,)
    assert await resumed.reopen(report("b", 0, 1), 0) is late
    assert await resumed.answer_finished(report("a", 0), "") is None, "it is open, and answers itself"
    await late.finish_now("the rest never came")
    answered = await resumed.answer_finished(report("a", 0), "")
    assert answered is not None
    assert [receipt.instant for receipt in answered.receipts] == [0]
    next(session.folder.rglob("*.jpg")).unlink()
    assert await resumed.answer_finished(report("a", 0), "") is None, "its node may have the only copy"
    again = await resumed.reopen(report("b", 0, 1), 0)
    assert not again.finished.is_set(), "it was finished, and takes images once more"
    await again.finish_now("the rest never came")


async def test_a_session_that_a_full_disk_left_is_finished_once_there_is_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = await begun_session(tmp_path, "a")
    await session.suspend()
    asked, rooms = 0, iter([0, SPARE_BYTES - 1, None, SPARE_BYTES])

    def free_bytes(_: Path) -> int:
        nonlocal asked
        asked += 1
        if (room := next(rooms)) is None:
            raise DiskError("it does not answer")
        return room

    monkeypatch.setattr(resumed_bursts, "free_bytes", free_bytes)
    taken_up: list[BurstSession] = []
    resumed, loop = ResumedBursts(tmp_path, taken_up.append, DISK), asyncio.get_running_loop()
    begun_s = loop.time()
    await resumed.finish_later(session.folder, lambda: 0)
    assert (asked, [again.folder for again in taken_up]) == (4, [session.folder])
    assert loop.time() - begun_s >= 4 * DISK_RETRY_S, "the disk is not asked all the time"
    for again in resumed.sessions():
        await again.suspend()


async def test_repair_without_nodes_finishes_with_what_is_there(tmp_path: Path) -> None:
    session = await begun_session(tmp_path, "a", "b")
    await session.accept_report(report("a", 0, 1), 0)
    await receive_image(session, upload("a", 0), pieces(IMAGE))
    busy = await repair(tmp_path, wait_s=0, address=Address("127.0.0.1", 0), log=Log())
    assert "being written" in busy[0].what
    await session.suspend()
    await repair(tmp_path, wait_s=0, address=Address("127.0.0.1", 0), log=Log())
    opened = Session.open(session.folder)
    assert lies(opened) == []
    assert len(opened.manifest.images) == 1
    assert all("no node sent it" in gap.reason for gap in opened.manifest.missing)


async def test_repair_says_who_may_still_have_missing_images(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    jpeg = cv2.imencode(".jpg", np.zeros((CAMERA.height, CAMERA.width), np.uint8))[1].tobytes()
    monkeypatch.setattr("tests.unit.node.bursts.IMAGE", jpeg)
    session = await begun_session(tmp_path, "a", "b", "c")
    gap = MissingImage(camera="a", instant=1, reason="the camera dropped the frame", dropped=True)
    await session.accept_report(report("a", 0, missing=(gap,)), 0)
    await receive_image(session, upload("a", 0), pieces(jpeg))
    await session.accept_report(report("c", 0, 1), 0)
    await session.finish_now("it sent nothing for 180 s")
    (result,) = await repair(tmp_path, wait_s=9, address=Address("127.0.0.1", 0), log=Log())
    assert (result.ok, result.changed, result.missing) == (True, False, 5)
    assert result.awaited == ("b", "c")
    for name in ("b", "c"):
        late = await ResumedBursts(tmp_path, lambda _: None, DISK).reopen(report(name, 0, 1), 0)
        await late.accept_report(report(name, 0, 1), 0)
        for instant in (0, 1):
            await receive_image(late, upload(name, instant), pieces(jpeg))
    (result,) = await repair(tmp_path, wait_s=9, address=Address("127.0.0.1", 0), log=Log())
    assert (result.awaited, result.missing) == ((), 1), "no node is asked for a frame that was dropped"


def test_two_nodes_never_share_a_spool_and_a_torn_journal_line_is_left_out(tmp_path: Path) -> None:
    spool = Spool(tmp_path, "a")
    assert spool.open() == []
    with pytest.raises(TryAgainError, match="another node uses"):
        Spool(tmp_path, "a").open()
    burst = spool.create_burst(report("a", 0, 1))
    burst.add([(upload("a", instant), IMAGE) for instant in (0, 1)])
    index = burst.folder / "000001.ndjson"
    index.write_bytes(index.read_bytes()[:-3])
    spool.close()
    (found,) = Spool(tmp_path, "a").open()
    assert found.read_report() == report("a", 0, 1)
    assert [image.record.instant for image in found.film.recover()] == [0]
