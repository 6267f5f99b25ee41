"""A camera whose report is invalid, about others or endless is left out; the others' burst is whole."""

import hashlib
from collections.abc import AsyncIterator
from contextlib import suppress
from pathlib import Path
from typing import Any

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
from capture_app.node.burst.burst_session import BurstSession
from capture_app.protocol.messages import CameraReport, ImageBatch, ImageUpload, SpoolSpace
from capture_app.session.format.burst_plan import MissingRun
from capture_app.session.format.calibration import CameraCalibration
from capture_app.session.format.manifest import CameraRecord, ClockRecord, MissingImage
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.sync.rig.frame_selection import Burst
from tests.facts import make_facts
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

CLOCK = ClockRecord(
    epoch_local_ns=0, offset_ns=0, skew_ppm=0.0, uncertainty_ns=1, hard_bound_ns=1, round_trip_ns=1, samples=1
)
HUGE = 2**62


async def pieces_of(data: bytes) -> AsyncIterator[bytes]:
    yield data


def streamed_session(folder: Path, *names: str) -> BurstSession:
    burst = Burst(1, INSTANTS_NS, PERIOD_NS, INSTANTS_NS[0], names, streamed=True)
    return BurstSession.begin(
        burst, dict.fromkeys(names, make_facts()), SessionWriter.create(folder, "b"), DISK
    )


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("plan", "camera", "facts", "row_time_ns"), HUGE),
        (("plan", "camera", "facts", "row_time_ns"), 1_000_000_001),
        (("plan", "camera", "facts", "height"), HUGE),
        (("plan", "camera", "facts", "model"), "x" * 201),
        (("plan", "camera", "clock", "offset_ns"), HUGE),
        (("plan", "camera", "clock", "skew_ppm"), 1e300),
        (("plan", "camera", "clock", "uncertainty_ns"), HUGE),
        (("plan", "missing"), [{"camera": "a", "instant": 0, "reason": "x" * 1001}]),
        (("events",), [{"event": "x" * 1001}]),
        (("events",), [{"event": HUGE}]),
        (("events",), [{"event": "x"}] * 201),
        (("leader",), HUGE),
    ],
)
def test_a_number_or_text_out_of_range_is_no_report(path: tuple[str, ...], value: Any) -> None:
    whole = report("a", 0, 1)
    whole = whole.with_plan(camera=replace(whole.plan.camera, clock=CLOCK))
    plain: Any = msgspec.to_builtins(whole)
    assert msgspec.json.decode(msgspec.json.encode(plain), type=CameraReport) == whole
    part = plain
    for key in path[:-1]:
        part = part[key]
    part[path[-1]] = value
    with pytest.raises(msgspec.ValidationError):
        msgspec.json.decode(msgspec.json.encode(plain), type=CameraReport)


@pytest.mark.parametrize(
    "field",
    ["leader_ns", "local_ns", "residual_ns", "uncertainty_ns", "exposure_start_ns", "gain", "sequence"],
)
def test_a_number_out_of_range_is_no_image(field: str) -> None:
    plain: Any = msgspec.to_builtins(upload("a", 0))
    plain["record"][field] = 1e300 if field == "gain" else HUGE
    with pytest.raises(msgspec.ValidationError):
        msgspec.json.decode(msgspec.json.encode(plain), type=ImageUpload)


LENS = CameraCalibration(
    width=64,
    height=48,
    fx=0.0,
    fy=1.0,
    cx=0.0,
    cy=0.0,
    rotation=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    translation=(0.0, 0.0, 0.0),
)
OF_B = MissingImage(camera="b", instant=1, reason="its lens is covered", dropped=True)


@pytest.mark.parametrize(
    "plan",
    [
        {"instants": (0,), "missing": (OF_B,)},
        {"instants": (0, 0)},
        {"instants": (0, 1), "missing": (MissingImage(camera="a", instant=1, reason=""),)},
        {"instants": (0, 9)},
        {"picking": True},
        {"picked": 1},
        {"missing_runs": (MissingRun(first=0, count=1, reason=""),)},
        {"calibration": LENS},
    ],
    ids=[
        "another's",
        "twice",
        "both",
        "not ordered",
        "picking",
        "picked",
        "runs",
        "lens",
    ],
)
async def test_a_report_that_cannot_be_true_leaves_its_camera_out(
    tmp_path: Path, plan: dict[str, Any]
) -> None:
    session = burst_session(tmp_path, "a", "b")
    with pytest.raises(BadInputError):
        await session.accept_report(report("a", 0, 1).with_plan(**plan), now_ns=0)
    await session.accept_report(report("b", 0, 1), now_ns=0)
    for instant in (0, 1):
        await receive_image(session, upload("b", instant), pieces(IMAGE))
    assert session.finished.is_set(), "nothing waits for a camera that was left out"
    manifest = saved(session).manifest
    assert [image.camera for image in manifest.images] == ["b", "b"]
    assert {gap.camera for gap in manifest.missing} == {"a"}
    assert not any(gap.dropped for gap in manifest.missing)


async def test_only_the_machine_that_takes_part_in_a_burst_speaks_for_its_camera(tmp_path: Path) -> None:
    session = burst_session(tmp_path, "a")
    await session.write_plan(LEADER, pins={"a": "its pin"})
    for pin in ("its pin", ""):
        session.check_machine("a", pin)
    with pytest.raises(BadInputError, match="another machine's camera"):
        session.check_machine("a", "another pin")
    session.check_machine("b", "any pin of a camera that had none, as its rig was open then")


async def test_a_report_that_says_nothing_again_and_again_holds_up_no_burst(tmp_path: Path) -> None:
    session = burst_session(tmp_path, "a", "b", spare=2)
    session.stream_opened("a")
    session.stream_opened("b")
    ends_ns, now_ns = session.burst.instants_ns[-1] + AFTER_LAST_INSTANT_NS, 0
    assert (await session.accept_report(report("b", 0, 1), ends_ns)).undecided
    while not session.finished.is_set():
        assert now_ns < ends_ns + CAMERA_STALLED_NS, "it never ends"
        now_ns += 5_000_000_000
        with suppress(BadInputError):
            await session.accept_report(report("a"), now_ns)
        if not (await session.accept_report(report("b", 0, 1), now_ns)).undecided:
            for instant in (0, 1):
                await receive_image(session, upload("b", instant), pieces(IMAGE), now_ns)
        await session.give_up_silent_cameras({}, now_ns)
    manifest = saved(session).manifest
    assert [image.camera for image in manifest.images] == ["b", "b"]
    assert {gap.reason for gap in manifest.missing} == {"its node did not report it"}


async def test_a_node_that_was_killed_keeps_what_it_still_has_of_a_burst(tmp_path: Path) -> None:
    """Its report leaves out the frame that it lost, as the burst's other cameras need not wait for that."""
    session = burst_session(tmp_path, "a", "b")
    answer = await session.accept_report(report("a", 1), now_ns=0)
    assert not answer.undecided
    await session.accept_report(report("b", 0, 1), now_ns=0)
    for name, instant in (("a", 1), ("b", 0), ("b", 1)):
        await receive_image(session, upload(name, instant), pieces(IMAGE))
    missing = saved(session).manifest.missing
    assert [(gap.camera, gap.instant, gap.reason) for gap in missing] == [
        ("a", 0, "its node did not report it")
    ]


async def test_a_node_that_was_started_again_changes_no_clock_of_a_burst(tmp_path: Path) -> None:
    """Its clock is another one, which the burst's images were not timed by."""
    session = burst_session(tmp_path, "a")
    await session.accept_report(report("a", 0, 1), now_ns=0)
    later = CameraRecord(name="a", facts=replace(CAMERA, exposure_ns=123_456))
    await session.accept_report(report("a", 0, 1).with_plan(camera=later), now_ns=0)
    for instant in (0, 1):
        await receive_image(session, upload("a", instant), pieces(IMAGE))
    assert saved(session).camera("a").facts == CAMERA


async def test_a_recording_waits_for_an_image_that_was_reported_missing_before(tmp_path: Path) -> None:
    burst = Burst(1, INSTANTS_NS, PERIOD_NS, INSTANTS_NS[0], ("a",), streamed=True, video=True)
    session = BurstSession.begin(burst, {"a": CAMERA}, SessionWriter.create(tmp_path, "b"), DISK)
    now_ns = INSTANTS_NS[-1] + AFTER_LAST_INSTANT_NS
    await session.accept_report(report("a", 0).with_plan(picking=True), now_ns)
    await receive_image(session, upload("a", 0), pieces(IMAGE), now_ns)
    gap = MissingRun(first=0, count=1, reason="it had left the ring buffer")
    await session.accept_report(report("a", 1).with_plan(picked=2, missing_runs=(gap,)), now_ns)
    assert not session.finished.is_set(), "as many images as are expected came, but not this one"
    await receive_image(session, upload("a", 1), pieces(IMAGE), now_ns)
    assert session.finished.is_set()


async def test_a_report_that_stays_without_its_spare_instants_holds_up_no_burst(tmp_path: Path) -> None:
    """A node that was started again never selects them, and another camera dropped an earlier frame."""
    session = burst_session(tmp_path, "a", "b", spare=2)
    session.stream_opened("a")
    session.stream_opened("b")
    ends_ns = session.burst.instants_ns[-1] + AFTER_LAST_INSTANT_NS
    gap = MissingImage(camera="b", instant=1, reason="the camera dropped the frame", dropped=True)
    told = report("a", 0, 1), report("b", 0, 2, 3, missing=(gap,))
    for now_ns in range(ends_ns, ends_ns + CAMERA_DISCONNECTED_NS, 2_000_000_000):
        assert all([(await session.accept_report(of, now_ns)).undecided for of in told])
        await session.give_up_silent_cameras({}, now_ns)
    await session.give_up_silent_cameras({}, ends_ns + CAMERA_DISCONNECTED_NS)
    answers = [await session.accept_report(of, ends_ns + CAMERA_DISCONNECTED_NS) for of in told]
    assert [answer.requested for answer in answers] == [(0, 1), (0, 1)]
    for name, instant in (("a", 0), ("a", 1), ("b", 0)):
        await receive_image(session, upload(name, instant), pieces(IMAGE))
    assert [(of.camera, of.instant) for of in saved(session).manifest.missing] == [("b", 1)]


async def test_a_recording_is_waited_for_while_its_frames_arrive(tmp_path: Path) -> None:
    burst = Burst(1, INSTANTS_NS, PERIOD_NS, INSTANTS_NS[0], ("a",), streamed=True, video=True)
    session = BurstSession.begin(burst, {"a": CAMERA}, SessionWriter.create(tmp_path, "b"), DISK)
    session.stream_opened("a")
    now_ns = INSTANTS_NS[-1] + AFTER_LAST_INSTANT_NS
    await session.accept_report(report("a", 0, 1).with_plan(picked=2), now_ns)
    frame = small_jpeg(bytes(MIN_UPLOAD_BYTES_PER_S * CAMERA_STALLED_NS // 10**9))
    for instant in (0, 1):
        now_ns += CAMERA_STALLED_NS - 1
        await session.give_up_silent_cameras({}, now_ns)
        sent = upload("a", instant)
        sha256 = hashlib.sha256(frame).hexdigest()
        record = replace(sent.record, bytes=len(frame), sha256=sha256)
        await receive_image(session, replace(sent, record=record), pieces_of(frame), now_ns)
    assert session.status.message == ""
    assert (session.status.received, session.status.done) == (2, True)


async def test_two_that_report_in_turns_hold_up_no_burst(tmp_path: Path) -> None:
    session = burst_session(tmp_path, "a", "b", "c")
    for name in ("a", "b", "c"):
        session.stream_opened(name)
    now_ns = session.burst.instants_ns[-1] + AFTER_LAST_INSTANT_NS
    await session.accept_report(report("c", 0, 1), now_ns)
    for instant in (0, 1):
        await receive_image(session, upload("c", instant), pieces(IMAGE), now_ns)
    await session.accept_report(report("a", 0, 1), now_ns)
    await session.accept_report(report("b", 0, 1), now_ns + CAMERA_STALLED_NS // 2)
    while not session.finished.is_set():
        now_ns += 1_000_000_000
        assert now_ns < session.burst.instants_ns[-1] + 2 * CAMERA_STALLED_NS, "it never ends"
        await session.give_up_silent_cameras({}, now_ns)
        for name in ("a", "b"):
            if not session.finished.is_set():
                await session.accept_report(report(name, 0, 1), now_ns)


async def test_events_are_in_the_name_of_their_sender(tmp_path: Path) -> None:
    session = burst_session(tmp_path, "a", "b")
    told = replace(report("a", 0, 1), events=({"camera": "b", "event": "frames-dropped"},))
    await session.accept_report(told, now_ns=0)
    lines = (session.folder / "events.ndjson").read_text().splitlines()
    assert [msgspec.json.decode(line)["camera"] for line in lines] == ["a"]


async def test_a_burst_ends_though_a_camera_selects_for_ever_and_is_silent(tmp_path: Path) -> None:
    session = streamed_session(tmp_path, "a", "b")
    last_ns = INSTANTS_NS[-1] + AFTER_LAST_INSTANT_NS
    session.stream_opened("a")
    session.stream_opened("b")
    await session.accept_report(report("a").with_plan(picking=True), now_ns=last_ns)
    await session.accept_report(report("b", 0, 1).with_plan(picked=2), now_ns=last_ns)
    for instant in (0, 1):
        await receive_image(session, upload("b", instant), pieces(IMAGE), now_ns=last_ns)
    await session.give_up_silent_cameras({}, last_ns + CAMERA_STALLED_NS - 1)
    assert not session.finished.is_set()
    await session.accept_report(report("a").with_plan(picking=True), now_ns=last_ns + CAMERA_STALLED_NS)
    await session.give_up_silent_cameras({}, last_ns + CAMERA_STALLED_NS)
    assert session.finished.is_set(), "it says that it selects, and sends nothing"
    assert [image.camera for image in saved(session).manifest.images] == ["b", "b"]


@pytest.mark.parametrize(
    "plan", [{"picked": 3}, {"missing_runs": (MissingRun(first=0, count=10**8, reason=""),)}]
)
async def test_no_camera_has_seen_instants_to_come(tmp_path: Path, plan: dict[str, Any]) -> None:
    """They would become missing images of all the others."""
    session = streamed_session(tmp_path, "a", "b")
    with pytest.raises(BadInputError, match="instants"):
        await session.accept_report(report("a").with_plan(**plan), now_ns=INSTANTS_NS[0] - 10**10)


def test_the_text_of_a_spool_has_a_length() -> None:
    space = SpoolSpace(camera="a", free_bytes=0, spool="/", problem="x" * 1001)
    with pytest.raises(msgspec.ValidationError):
        msgspec.json.decode(msgspec.json.encode(space), type=SpoolSpace)


@pytest.mark.parametrize(("kind", "truth_bytes"), [("v4l2", 1), ("sim", 20_000_000)])
async def test_ground_truth_is_a_simulated_cameras_and_of_its_pixels(
    tmp_path: Path, kind: str, truth_bytes: int
) -> None:
    facts = make_facts(kind=kind, width=640, height=480)
    burst = Burst(1, INSTANTS_NS, PERIOD_NS, INSTANTS_NS[0], ("a", "b"))
    writer = SessionWriter.create(tmp_path, "burst-001")
    session = BurstSession.begin(burst, {"a": facts, "b": CAMERA}, writer, DISK)
    for name, of in (("a", facts), ("b", CAMERA)):
        record = CameraRecord(name=name, facts=of)
        await session.accept_report(report(name, 0, 1).with_plan(camera=record), now_ns=0)
    sent = replace(upload("a", 0), truth_bytes=truth_bytes)
    with pytest.raises(BadInputError, match="ground truth"):
        await session.take(ImageBatch(images=(sent,)), pieces(IMAGE), 0)
    for instant in (0, 1):
        await receive_image(session, upload("b", instant), pieces(IMAGE))
    assert session.session is not None, "its camera is left out, and the others are saved"


async def test_ground_truth_counts_in_the_room_that_the_next_burst_needs(tmp_path: Path) -> None:
    facts = make_facts(kind="sim", width=640, height=480)
    burst = Burst(1, INSTANTS_NS, PERIOD_NS, INSTANTS_NS[0], ("a",))
    session = BurstSession.begin(burst, {"a": facts}, SessionWriter.create(tmp_path, "burst-001"), DISK)
    record, truth = CameraRecord(name="a", facts=facts), b"depth" * 100
    await session.accept_report(report("a", 0, 1).with_plan(camera=record), now_ns=0)
    for instant in (0, 1):
        with_truth = replace(upload("a", instant), truth_bytes=len(truth), true_ns=1)
        await receive_image(session, with_truth, pieces(IMAGE + truth))
    assert session.mean_image_bytes() == {"a": len(IMAGE) + len(truth)}
