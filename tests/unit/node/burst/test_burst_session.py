"""A burst on the leader's side: whatever comes or does not come, a session that says so."""

import asyncio
import hashlib
import os
from collections.abc import AsyncIterator
from pathlib import Path

import msgspec
import pytest
from msgspec.structs import replace

from capture_app.common.errors import BadInputError
from capture_app.common.timeouts import (
    AFTER_LAST_INSTANT_NS,
    CAMERA_DISCONNECTED_NS,
    CAMERA_STALLED_NS,
    MIN_UPLOAD_BYTES_PER_S,
)
from capture_app.node.burst.burst_session import MARK_MARGIN_NS, BurstSession
from capture_app.node.burst.plans import burst_record, result_text
from capture_app.node.leader.bursts import create_numbered
from capture_app.protocol.messages import CameraReport
from capture_app.session.format.manifest import EVENTS, AbsentCamera, MissingImage, PhaseRecord
from capture_app.session.library.listing import list_sessions
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.sync.rig.frame_selection import Burst
from tests.images import small_jpeg
from tests.unit.node.bursts import (
    CAMERA,
    DISK,
    IMAGE,
    INSTANTS_NS,
    LEADER,
    PERIOD_NS,
    burst_session,
    pieces,
    receive_image,
    report,
    saved,
    upload,
)

pytestmark = pytest.mark.virtual


async def deliver(session: BurstSession, name: str, *instants: int) -> None:
    await session.accept_report(report(name, *instants), now_ns=0)
    for instant in instants:
        await receive_image(session, upload(name, instant), pieces(IMAGE))


def files_in(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file()]


async def test_it_is_finished_when_every_camera_has_delivered(tmp_path: Path) -> None:
    session = burst_session(tmp_path, "a", "b")
    await deliver(session, "a", 0, 1)
    assert not session.finished.is_set()
    await deliver(session, "b", 0, 1)
    assert session.finished.is_set()
    assert len(saved(session).manifest.images) == 4
    assert session.status.message == ""


async def test_a_recording_counts_what_its_cameras_have_not_encoded_yet(tmp_path: Path) -> None:
    instants_ns = tuple(INSTANTS_NS[0] + PERIOD_NS * n for n in range(300))
    burst = Burst(1, instants_ns, PERIOD_NS, INSTANTS_NS[0], ("a",), streamed=True, video=True)
    session = BurstSession.begin(burst, {"a": CAMERA}, SessionWriter.create(tmp_path, "recording-001"), DISK)
    counts = []
    for seconds in (1, 4, 9):
        await session.give_up_silent_cameras({}, INSTANTS_NS[0] + seconds * 10**9)
        counts.append((session.status.received, session.status.expected))
    assert counts == [(0, 31), (0, 121), (0, 271)]


@pytest.mark.skipif(os.name == "nt", reason="Windows renames no folder in which files are open")
async def test_a_folder_that_is_renamed_meanwhile_is_told_at_once(tmp_path: Path) -> None:
    session = burst_session(tmp_path, "a")
    session.folder.rename(tmp_path / "jump")
    await session.accept_report(report("a", 0, 1), now_ns=0)
    await receive_image(session, upload("a", 0), pieces(IMAGE))
    assert session.status.message == f"its folder is {tmp_path / 'jump'} now"


async def test_whether_an_image_is_late_goes_by_the_camera_as_first_reported(tmp_path: Path) -> None:
    """A node that was started again during a recording does not know its phase, and calls nothing late."""
    session = burst_session(tmp_path, "a")
    told, phase = (
        report("a", 0, 1),
        PhaseRecord(residual_ns=0, period_ns=PERIOD_NS, drift_ppm=0.0, corrections=0, tolerance_ns=4),
    )
    known = replace(told.plan, camera=replace(told.plan.camera, phase=phase))
    await session.accept_report(replace(told, plan=known), now_ns=0)
    for instant in (0, 1):
        await receive_image(session, upload("a", instant), pieces(IMAGE))
    assert [image.late for image in Session.open(tmp_path / "burst-001").manifest.images] == [True, True]
    problems = verify(Session.open(tmp_path / "burst-001"))
    assert not [problem for problem in problems if "late" in str(problem)]


async def test_an_image_that_is_sent_again_is_stored_once(tmp_path: Path) -> None:
    session = burst_session(tmp_path, "a")
    await session.accept_report(report("a", 0, 1), now_ns=0)
    first = await receive_image(session, upload("a", 0), pieces(IMAGE))
    assert await receive_image(session, upload("a", 0), pieces(IMAGE)) == first
    await receive_image(session, upload("a", 1), pieces(IMAGE))
    assert len(saved(session).manifest.images) == 2


@pytest.mark.parametrize(
    "path",
    ["../../evil.jpg", "/evil.jpg", "images/rig1/b/000000.jpg", "images/rig1/a/000001.jpg", "a.exe", ""],
)
async def test_a_node_writes_to_its_own_place_only(tmp_path: Path, path: str) -> None:
    root = tmp_path / "sessions"
    session = burst_session(root, "a", "b")
    await session.accept_report(report("a", 0, 1), now_ns=0)
    await session.accept_report(report("b", 0, 1), now_ns=0)
    honest = upload("a", 0)
    sly = msgspec.structs.replace(honest, record=msgspec.structs.replace(honest.record, path=path))
    with pytest.raises(BadInputError):
        await receive_image(session, sly, pieces(IMAGE))
    written = files_in(tmp_path)
    assert all(file.is_relative_to(root / "burst-001") for file in written)
    assert not {file.suffix for file in written} & {".jpg", ".exe"}


async def test_what_a_camera_says_it_lacks_is_in_the_manifest(tmp_path: Path) -> None:
    session = burst_session(tmp_path, "a")
    gap = MissingImage(camera="a", instant=1, reason="the camera dropped the frame")
    await session.accept_report(report("a", 0, missing=(gap,)), now_ns=0)
    await receive_image(session, upload("a", 0), pieces(IMAGE))
    assert saved(session).manifest.missing == (gap,)
    assert "dropped" in session.status.message


async def test_a_camera_that_takes_no_part_does_not_hold_up_the_others(tmp_path: Path) -> None:
    session = burst_session(tmp_path, "a", "b")
    await session.give_up_camera("b", "its clock is not synchronized yet")
    await deliver(session, "a", 0, 1)
    assert {gap.reason for gap in saved(session).manifest.missing} == {"its clock is not synchronized yet"}
    assert [camera.name for camera in saved(session).manifest.cameras] == ["a", "b"]


async def test_a_camera_without_a_stream_is_given_up_after_a_while(tmp_path: Path) -> None:
    session = burst_session(tmp_path, "a", "b")
    await deliver(session, "a", 0, 1)
    session.stream_opened("b")
    last_ns = INSTANTS_NS[-1] + 2_000_000_000
    await session.give_up_silent_cameras({}, last_ns + 2 * CAMERA_DISCONNECTED_NS)
    assert not session.finished.is_set(), "its stream is open: it is at work"
    session.stream_closed("b", last_ns + 2 * CAMERA_DISCONNECTED_NS)
    await session.give_up_silent_cameras({}, last_ns + 3 * CAMERA_DISCONNECTED_NS - 1)
    assert not session.finished.is_set(), "it may come back"
    await session.give_up_silent_cameras({"b": "lost: silent for 2 s"}, last_ns + 3 * CAMERA_DISCONNECTED_NS)
    assert {gap.reason for gap in saved(session).manifest.missing} == {"lost: silent for 2 s"}


async def test_a_lost_camera_is_not_awaited_as_its_stream_seems_open(tmp_path: Path) -> None:
    session = burst_session(tmp_path, "a")
    session.stream_opened("a")
    at_ns = INSTANTS_NS[-1] + AFTER_LAST_INSTANT_NS + CAMERA_DISCONNECTED_NS
    await session.give_up_silent_cameras({"a": "lost: silent for 2 s"}, at_ns)
    assert {gap.reason for gap in saved(session).manifest.missing} == {"lost: silent for 2 s"}


async def test_what_has_happened_to_a_camera_is_stored_once(tmp_path: Path) -> None:
    """Its node reports it again over each stream that it opens."""
    session = burst_session(tmp_path, "a")
    for _ in range(2):
        await session.accept_report(replace(report("a", 0), events=({"event": "frames-dropped"},)), 0)
    assert (session.folder / EVENTS).read_text().count("frames-dropped") == 1


async def test_a_camera_that_stalls_is_given_up_in_the_end(tmp_path: Path) -> None:
    session = burst_session(tmp_path, "a")
    session.stream_opened("a")
    await session.accept_report(report("a", 0, 1), now_ns=5_000_000_000)
    await receive_image(session, upload("a", 0), pieces(IMAGE), now_ns=5_000_000_000)
    await session.give_up_silent_cameras({}, 5_000_000_000 + CAMERA_STALLED_NS + 1_000_000_000)
    assert len(saved(session).manifest.images) == 1


@pytest.mark.parametrize(
    ("short_timeout", "bytes_per_s", "comes"),
    [
        (False, MIN_UPLOAD_BYTES_PER_S, True),
        (True, MIN_UPLOAD_BYTES_PER_S, True),
        (False, MIN_UPLOAD_BYTES_PER_S // 2, False),
    ],
)
async def test_an_image_over_a_slow_link_is_waited_for_while_it_comes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, short_timeout: bool, bytes_per_s: int, comes: bool
) -> None:
    # It is larger than any of these cameras' images.
    monkeypatch.setattr("capture_app.node.burst.burst_session.size_problem", lambda *_: None)
    session = burst_session(tmp_path, "a", short_timeouts=("a",) if short_timeout else ())
    session.stream_opened("a")
    began_ns = now_ns = 5_000_000_000
    gap = MissingImage(camera="a", instant=1, reason="the camera dropped the frame")
    await session.accept_report(report("a", 0, missing=(gap,)), now_ns)
    step_ns = (CAMERA_DISCONNECTED_NS if short_timeout else CAMERA_STALLED_NS) // 2
    piece_bytes = bytes_per_s * step_ns // 10**9
    image = small_jpeg(bytes(max(0, 8 * piece_bytes - len(small_jpeg()))))
    # Its heartbeats may be lost where its images take all of the link.
    lost = {"a": "lost: silent for 2 s"} if short_timeout else {}

    async def slowly() -> AsyncIterator[bytes]:
        nonlocal now_ns
        for begin in range(0, len(image), piece_bytes):
            yield image[begin : begin + piece_bytes]
            now_ns += step_ns
            await session.give_up_silent_cameras(lost, now_ns)

    sent = upload("a", 0)
    sha256 = hashlib.sha256(image).hexdigest()
    sent = msgspec.structs.replace(
        sent, record=msgspec.structs.replace(sent.record, bytes=len(image), sha256=sha256)
    )
    if not comes:
        with pytest.raises(BadInputError, match="is over"):
            await receive_image(session, sent, slowly(), began_ns)
        return
    await receive_image(session, sent, slowly(), began_ns)
    (saved_image,) = saved(session).manifest.images
    assert saved_image.bytes == len(image)


async def test_without_any_image_there_is_no_session(tmp_path: Path) -> None:
    session = burst_session(tmp_path, "a")
    await session.give_up_camera("a", "its clock is not synchronized yet")
    assert session.finished.is_set()
    assert session.session is None
    assert list_sessions(tmp_path) == []


async def test_damaged_foreign_and_late_images_are_refused(tmp_path: Path) -> None:
    session = burst_session(tmp_path, "a")
    with pytest.raises(BadInputError, match="damaged"):
        await receive_image(session, upload("a", 0), pieces(IMAGE[:-1] + b"3"))
    with pytest.raises(BadInputError, match="not in burst"):
        await receive_image(session, upload("b", 0), pieces(IMAGE))
    await deliver(session, "a", 0, 1)
    with pytest.raises(BadInputError, match="is over"):
        await receive_image(session, upload("a", 0), pieces(IMAGE))


def test_numbers_of_sessions_are_never_used_twice(tmp_path: Path) -> None:
    (tmp_path / "burst-007").mkdir()
    for expected in (8, 9):
        writer, number = create_numbered(tmp_path)
        assert (writer.name, number) == (f"burst-{expected:03d}", expected)
        writer.abort()
    writer, number = create_numbered(tmp_path, after=11)
    assert (writer.name, number) == ("burst-012", 12)
    writer.abort()


async def test_people_read_what_owners_call_the_cameras(tmp_path: Path) -> None:
    facts = {name: replace(CAMERA, label=label) for name, label in (("Bohm", "Böhm"), ("cam1", "カメラ"))}
    burst = Burst(1, INSTANTS_NS, PERIOD_NS, INSTANTS_NS[0], tuple(facts))
    absent = {"cam2": AbsentCamera(name="cam2", reason="no room", label="左")}
    session = BurstSession.begin(burst, facts, SessionWriter.create(tmp_path, "b"), DISK, absent=absent)
    assert {part.camera: part.label for part in session.status.transfer} == {
        "Bohm": "Böhm",
        "cam1": "カメラ",
        "cam2": "左",
    }
    assert session.status.message == "without 左: no room"
    gap = MissingImage(camera="cam1", instant=1, reason="dropped it")
    titles = {"cam1": "カメラ"}
    assert result_text(burst_record(burst), [gap], titles) == "1 image missing (カメラ: dropped it)"


async def test_a_mark_belongs_to_the_open_take_of_this_run_around_its_time(tmp_path: Path) -> None:
    session = burst_session(tmp_path, "a")
    await session.write_plan(LEADER)
    begins_ns, ends_ns = INSTANTS_NS[0] - MARK_MARGIN_NS, INSTANTS_NS[-1] + MARK_MARGIN_NS
    assert [session.contains(at_ns) for at_ns in (begins_ns - 1, begins_ns, ends_ns, ends_ns + 1)] == [
        False, True, True, False,
    ]  # fmt: skip
    await session.suspend()
    assert not session.contains(begins_ns), "it is closed"
    again = await asyncio.to_thread(BurstSession.resume, session.folder, 0, DISK)
    assert not again.contains(begins_ns), "the leader's clock was another one"
    await again.suspend()


def streamed_session(folder: Path, *names: str, frames: int = 30, video: bool = True) -> BurstSession:
    instants_ns = range(INSTANTS_NS[0], INSTANTS_NS[0] + frames * PERIOD_NS, PERIOD_NS)
    burst = Burst(1, instants_ns, PERIOD_NS, INSTANTS_NS[0], names, streamed=True, video=video)
    writer = SessionWriter.create(folder, "recording-001")
    return BurstSession.begin(burst, dict.fromkeys(names, CAMERA), writer, DISK)


def picking(name: str) -> CameraReport:
    return report(name).with_plan(picking=True)


async def test_cameras_that_take_frames_after_the_last_instant_have_missed_the_end(tmp_path: Path) -> None:
    session = streamed_session(tmp_path, "a", "b")
    over_ns = session.burst.instants_ns[-1] + AFTER_LAST_INSTANT_NS
    assert not session.is_overrun(over_ns), "nobody takes frames"
    for name in ("a", "b"):
        await session.accept_report(picking(name), INSTANTS_NS[0])
    assert [session.is_overrun(over_ns + later_ns) for later_ns in (-1, 0)] == [False, True]
    await session.give_up_camera("a", "lost")
    assert session.is_overrun(over_ns)
    await session.give_up_camera("b", "lost")
    assert not session.is_overrun(over_ns)
    stills = burst_session(tmp_path, "a")
    await stills.accept_report(report("a", 0, 1), INSTANTS_NS[1])
    assert not stills.is_overrun(over_ns)
    earlier = streamed_session(tmp_path / "earlier", "a")
    await earlier.write_plan(LEADER)
    await earlier.suspend()
    again = BurstSession.resume(earlier.folder, 0, DISK)
    await again.accept_report(picking("a"), INSTANTS_NS[0])
    assert not again.is_overrun(over_ns), "no run but the one that ordered it can end it"
    await again.suspend()


async def test_a_camera_that_was_silent_and_brought_nothing_is_awaited_for_a_shorter_time_next(
    tmp_path: Path,
) -> None:
    session = burst_session(tmp_path, "brought", "refused", "silent", "there")
    await session.accept_report(report("brought", 0, 1), now_ns=0)
    await receive_image(session, upload("brought", 0), pieces(IMAGE))
    await session.give_up_camera("refused", "its clock is not synchronized yet")
    for name in ("brought", "silent"):
        await session.give_up_camera(name, "no answer", silent=True)
    assert session.silent_cameras() == {"silent"}
    assert not session.is_empty()


async def test_a_camera_has_so_long_after_its_last_stream_was_closed(tmp_path: Path) -> None:
    session = burst_session(tmp_path, "a")
    closed_ns = INSTANTS_NS[-1] + AFTER_LAST_INSTANT_NS + 2 * CAMERA_DISCONNECTED_NS
    for _ in range(2):
        session.stream_opened("a")
    session.stream_closed("a", INSTANTS_NS[-1])
    await session.give_up_silent_cameras({}, closed_ns)
    assert session.status.transfer[0].problem == "", "it has another stream"
    session.stream_closed("a", closed_ns)
    await session.give_up_silent_cameras({}, closed_ns + CAMERA_DISCONNECTED_NS - 1)
    assert session.status.transfer[0].problem == ""
    await session.give_up_silent_cameras({}, closed_ns + CAMERA_DISCONNECTED_NS + 1)
    assert session.status.transfer[0].problem


@pytest.mark.parametrize("video", [False, True])
async def test_what_a_status_says_of_a_take_that_is_resumed(tmp_path: Path, video: bool) -> None:
    session = streamed_session(tmp_path, "a", video=video)
    first_ns = session.burst.instants_ns[0]
    assert (session.status.burst, session.status.first_leader_ns) == (1, first_ns)
    await session.write_plan(LEADER)
    await session.accept_report(picking("a"), first_ns)
    await session.suspend()
    again = BurstSession.resume(session.folder, 0, DISK)
    # What is now by this run's clock says nothing of an earlier run's recording.
    await again.give_up_silent_cameras({}, session.burst.instants_ns[9])
    status, frames = again.status, 0 if video else 30
    assert (status.burst, status.first_leader_ns, status.done) == (0, 0, False)
    assert (status.instants, status.expected, status.recording) == (frames, frames, video)
    whose = f"recording-001 of an earlier run: 0 of {frames} images"
    assert status.message == f"{whose}, waiting for images that its nodes still have"
    again.stream_opened("a")
    assert again.status.message.startswith(whose)
    assert again.status.message.endswith(
        "waiting for images that its nodes still have" if video else "30 arriving"
    )
    again.trouble = "the disk is full"
    assert again.status.message == f"{whose}, the disk is full"
    again.message = "left unfinished"
    assert again.status.message == f"{whose}, left unfinished"
    await again.suspend()
    whose = "recording-001 of an earlier run: 0 of 30 images"
    assert again.status.message.startswith(f"{whose}; left unfinished: ")
    assert again.status.ended is video
