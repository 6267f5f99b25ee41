"""Bursts that skip instants of which some camera lacks its frame, on the leader's side, and after a crash."""

import asyncio
from pathlib import Path

import pytest

from capture_app.common.address import Address
from capture_app.common.errors import BadInputError, DiskFullError, TryAgainError
from capture_app.common.timeouts import CAMERA_DISCONNECTED_NS
from capture_app.machine.repair import repair
from capture_app.node.burst.burst_session import BurstSession
from capture_app.protocol.log import Log
from capture_app.protocol.messages import CameraReport
from capture_app.session.format.burst_plan import BurstPlan, read_plan
from capture_app.session.format.manifest import MissingImage, SkippedFrame, SkippedInstant
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from capture_app.session.writing.session_writer import SessionWriter
from tests.unit.node.bursts import (
    DISK,
    IMAGE,
    INSTANTS_NS,
    LEADER,
    PERIOD_NS,
    burst_session,
    pieces,
    receive_image,
    report,
    upload,
)

pytestmark = pytest.mark.virtual


class FullDisk(SessionWriter):
    """A writer whose disk takes the first plan of a burst, and no later one."""

    def set_plan(self, plan: BurstPlan) -> None:
        if self.plan is not None:
            raise DiskFullError("the disk is full")
        super().set_plan(plan)


async def test_instants_that_a_full_disk_does_not_take_are_the_first_ones(tmp_path: Path) -> None:
    session = burst_session(tmp_path, "a", "b", spare=2, kind=FullDisk)
    await session.write_plan(LEADER)
    await session.accept_report(dropping("a", 4, 1), 0)
    await session.give_up_camera("b", "it sent nothing", silent=True)
    assert session.session is not None, session.message
    assert Session.open(session.session).manifest.burst.instants_ns == INSTANTS_NS


def dropping(name: str, ordered: int, *dropped: int) -> CameraReport:
    """What a camera tells of the first so many instants that were ordered."""
    gaps = (
        MissingImage(camera=name, instant=n, reason="the camera dropped the frame", dropped=True)
        for n in dropped
    )
    return report(name, *(n for n in range(ordered) if n not in dropped), missing=tuple(gaps))


async def begun(root: Path, *names: str) -> BurstSession:
    session = burst_session(root, *names, spare=2)
    await session.write_plan(LEADER)
    return session


async def deliver(session: BurstSession, name: str, *instants: int) -> None:
    for instant in instants:
        await receive_image(session, upload(name, instant), pieces(IMAGE))


def saved(session: BurstSession) -> Session:
    assert session.session is not None
    opened = Session.open(session.session)
    assert [str(lie) for lie in verify(opened) if lie.kind != "unreadable"] == []
    return opened


async def test_an_instant_that_a_camera_dropped_is_skipped_and_said_so(tmp_path: Path) -> None:
    session = await begun(tmp_path, "a", "b")
    assert (await session.accept_report(dropping("a", 3, 1), 0)).undecided
    first = await session.accept_report(dropping("b", 2), 0)
    assert first.undecided, "it has not told of the third instant yet"
    assert (await session.accept_report(dropping("b", 3), 0)).requested == (0, 2)
    assert (await session.accept_report(dropping("a", 3, 1), 0)).requested == (0, 2)
    assert read_plan(session.folder).chosen == (0, 2), "it is on disk before a node hears of it"
    await deliver(session, "a", 0, 2)
    await deliver(session, "b", 2, 0)
    assert session.finished.is_set()
    status = session.status
    assert (status.received, status.expected, status.instants) == (4, 4, 2)
    assert status.message == "1 instant skipped: a dropped 1 frame"
    manifest = saved(session).manifest
    assert manifest.burst.instants_ns == (INSTANTS_NS[0], INSTANTS_NS[0] + 2 * PERIOD_NS)
    why = SkippedFrame(camera="a", reason="the camera dropped the frame", dropped=True)
    skipped = SkippedInstant(leader_ns=INSTANTS_NS[0] + PERIOD_NS, missing=(why,))
    assert manifest.burst.skipped == status.skipped == (skipped,)
    assert manifest.missing == ()
    assert [(image.camera, image.instant, image.path[-10:]) for image in manifest.images] == [
        ("a", 0, "000000.jpg"), ("b", 0, "000000.jpg"), ("a", 1, "000001.jpg"), ("b", 1, "000001.jpg")
    ]  # fmt: skip


async def test_a_burst_without_drops_skips_nothing_and_waits_for_no_spare_instant(tmp_path: Path) -> None:
    session = await begun(tmp_path, "a")
    assert (await session.accept_report(dropping("a", 2), 0)).requested == (0, 1)
    await deliver(session, "a", 0, 1)
    assert saved(session).manifest.burst.skipped == ()
    assert session.status.message == ""


async def test_only_what_is_wanted_is_taken(tmp_path: Path) -> None:
    session = await begun(tmp_path, "a", "b")
    await session.accept_report(dropping("a", 4), 0)
    with pytest.raises(TryAgainError, match="not decided"):
        await deliver(session, "a", 0)
    await session.accept_report(dropping("b", 4), 0)
    with pytest.raises(BadInputError, match="instant 3 was not chosen"):
        await deliver(session, "a", 3)
    await session.suspend()


async def test_a_report_waits_for_the_other_cameras(tmp_path: Path) -> None:
    session = await begun(tmp_path, "a", "b")
    waiting = asyncio.create_task(session.accept_report(dropping("a", 3), 0, wait_s=60.0))
    while not session.status.message:  # noqa: ASYNC110 - nothing tells of it
        await asyncio.sleep(0)
    assert session.status.message == "waiting to hear from b"
    await session.accept_report(dropping("b", 3, 0), 0)
    assert (await waiting).requested == (1, 2)
    await session.suspend()


async def test_a_lost_camera_does_not_hold_up_the_others(tmp_path: Path) -> None:
    session = await begun(tmp_path, "a", "b")
    session.stream_opened("a")
    late_ns = INSTANTS_NS[0] + 3 * PERIOD_NS + 2_000_000_000 + CAMERA_DISCONNECTED_NS
    await session.accept_report(dropping("a", 3, 0), late_ns)
    await session.give_up_silent_cameras({"b": "lost: silent for 2 s"}, late_ns)
    await deliver(session, "a", 1, 2)
    manifest = saved(session).manifest
    assert {(gap.camera, gap.instant, gap.reason) for gap in manifest.missing} == {
        ("b", 0, "lost: silent for 2 s"), ("b", 1, "lost: silent for 2 s")
    }  # fmt: skip
    assert len(manifest.burst.skipped) == 1


async def test_with_too_few_complete_instants_the_burst_has_those_of_the_most_cameras(tmp_path: Path) -> None:
    session = await begun(tmp_path, "a", "b")
    await session.accept_report(dropping("a", 4, 0, 1, 3), 0)
    assert (await session.accept_report(dropping("b", 4, 1), 0)).requested == (0, 2)
    await deliver(session, "a", 2)
    await deliver(session, "b", 0, 2)
    manifest = saved(session).manifest
    assert [(gap.camera, gap.instant, gap.dropped) for gap in manifest.missing] == [("a", 0, True)]
    assert "1 image missing" in session.status.message


async def test_a_leader_that_is_killed_goes_on_with_the_instants_it_told(tmp_path: Path) -> None:
    session = await begun(tmp_path, "a", "b")
    await session.accept_report(dropping("a", 3, 0), 0)
    await session.accept_report(dropping("b", 3), 0)
    await deliver(session, "a", 2)
    await session.suspend()
    again = await asyncio.to_thread(BurstSession.resume, session.folder, 0, DISK)
    # What a node tells now is of no account: another one may have heard of the instants before.
    answer = await again.accept_report(dropping("b", 4, 1), 0)
    assert (answer.requested, answer.receipts) == ((1, 2), ())
    answer = await again.accept_report(dropping("a", 3, 0), 0)
    assert [receipt.instant for receipt in answer.receipts] == [2]
    await deliver(again, "a", 1)
    await deliver(again, "b", 2)
    manifest = saved(again).manifest
    assert [(image.camera, image.instant) for image in manifest.images] == [("a", 0), ("a", 1), ("b", 1)]
    assert [(gap.camera, gap.instant) for gap in manifest.missing] == [("b", 0)]
    assert len(manifest.burst.skipped) == 1


async def test_a_leader_that_is_killed_before_it_has_told_asks_again(tmp_path: Path) -> None:
    session = await begun(tmp_path, "a", "b")
    await session.accept_report(dropping("a", 3, 0), 0)
    await session.suspend()
    again = await asyncio.to_thread(BurstSession.resume, session.folder, 0, DISK)
    assert (await again.accept_report(dropping("a", 3, 0), 0)).undecided
    assert (await again.accept_report(dropping("b", 3), 0)).requested == (1, 2)
    await again.suspend()


async def test_an_interrupted_burst_that_told_nothing_is_repaired_without_nodes(tmp_path: Path) -> None:
    session = await begun(tmp_path, "a", "b")
    await session.accept_report(dropping("a", 3, 0), 0)
    await session.suspend()
    (result,) = await repair(session.folder, wait_s=0, address=Address("127.0.0.1", 0), log=Log())
    assert (result.ok, result.images, result.missing) == (True, 0, 4)


async def test_a_repaired_session_awaits_no_image_that_its_camera_lacks(tmp_path: Path) -> None:
    session = burst_session(tmp_path, "a", "b")
    await session.write_plan(LEADER)
    await session.accept_report(dropping("a", 2, 0, 1), 0)
    await session.suspend()
    (result,) = await repair(session.folder, wait_s=0, address=Address("127.0.0.1", 0), log=Log())
    assert (result.ok, result.missing, result.awaited) == (True, 4, ("b",))
