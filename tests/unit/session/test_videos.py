"""Recordings: frames in a video are images like others, and nothing about them is believed unchecked."""

import dataclasses
import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from capture_app.cli import run
from capture_app.common.errors import BadInputError, DiskError, ExitCode
from capture_app.companions.exporting.export_session import export_session
from capture_app.session.format.manifest import BurstRecord
from capture_app.session.library.changes import set_note
from capture_app.session.library.listing import read_card
from capture_app.session.reading.reader import Session
from capture_app.session.reading.take_sheet import TakeSheet
from capture_app.session.reading.verify import verify
from capture_app.session.writing.recovery import SET_ASIDE
from capture_app.session.writing.session_writer import SessionWriter
from tests.unit.session.recorded import frame, record, save_frames

from .conftest import INSTANTS, camera_record, edit_manifest, jpeg, local_from_leader

VIDEO, LINES = "videos/rig1/left.mjpeg", "videos/rig1/left.frames.ndjson"


@pytest.fixture
def recording(tmp_path: Path) -> Session:
    return record(SessionWriter.create(tmp_path, "recording"))


def test_a_recording_is_a_session_like_any_other(recording: Session) -> None:
    assert verify(recording) == []
    assert [(image.camera, image.instant) for image in recording.manifest.images] == [
        ("left", 0), ("right", 0), ("left", 1), ("right", 1), ("left", 2),
    ]  # fmt: skip
    image = recording.manifest.images[2]
    assert recording.image_bytes(image) == jpeg(1, 32, 24)
    assert (image.residual_ns, image.local_ns) == (4_000, local_from_leader(image.leader_ns))
    assert (recording.folder / VIDEO).read_bytes() == b"".join(jpeg(n, 32, 24) for n in range(3))
    times = recording.true_times()
    assert times is not None
    assert [time.true_ns for time in times.images] == [5, 6, 7, 5, 6]
    assert not (recording.folder / "ground_truth").exists(), "its frames themselves tell"
    card = read_card(recording.folder)
    assert (card.images, card.missing) == (5, 1)
    assert card.first_image == recording.folder / VIDEO
    sheet = TakeSheet.open(recording.folder)
    assert sheet.load("left", 2) is not None
    assert sheet.load("right", 2) is None


def test_frames_of_a_staggered_recording_are_due_as_planned(tmp_path: Path) -> None:
    writer, delay_ns = SessionWriter.create(tmp_path, "staggered"), 8_000_000
    for instant in range(2):
        save_frames(writer, frame("left", instant))
        late = frame("right", instant)
        leader_ns = late.record.leader_ns + delay_ns
        times_ns = {"leader_ns": leader_ns, "local_ns": local_from_leader(leader_ns)}
        save_frames(writer, dataclasses.replace(late, record=replace(late.record, **times_ns)))
    cameras = [camera_record(name, width=32, height=24) for name in ("left", "right")]
    cameras[1] = replace(cameras[1], delay_ns=delay_ns)
    session = writer.finish(cameras, BurstRecord(instants_ns=INSTANTS[:2], period_ns=33_000_000))
    assert [image.residual_ns for image in session.manifest.images] == [4_000] * 4
    assert verify(session) == []


def test_frames_of_no_instant_are_no_images(recording: Session) -> None:
    def cut(content: dict[str, Any]) -> None:
        content["burst"]["instants_ns"], content["missing"] = INSTANTS[:2], []
        del content["sync"]

    edit_manifest(recording, cut)
    images = Session.open(recording.folder).manifest.images
    assert [(image.camera, image.instant) for image in images] == [
        ("left", 0), ("right", 0), ("left", 1), ("right", 1),
    ]  # fmt: skip


def test_a_recordings_manifest_stays_small_and_keeps_its_note(recording: Session) -> None:
    assert json.loads((recording.folder / "session.json").read_bytes())["images"] == []
    set_note(recording.folder, "she lands on the mat")
    after = Session.open(recording.folder)
    assert (after.manifest.note, after.manifest.images) == ("she lands on the mat", recording.manifest.images)
    assert json.loads((recording.folder / "session.json").read_bytes())["images"] == []
    assert verify(after) == []


def test_a_recording_is_exported_frame_by_frame(recording: Session, tmp_path: Path) -> None:
    export_session(recording, "mp4", tmp_path / "mp4")
    assert sorted(path.suffix for path in (tmp_path / "mp4").rglob("*.mp4")) == [".mp4", ".mp4"]
    export_session(recording, "colmap", tmp_path / "colmap", link=True)
    for image in recording.manifest.images:
        name = f"images/rig1/{image.camera}/{image.instant:06d}.jpg"
        assert (tmp_path / "colmap" / name).read_bytes() == recording.image_bytes(image)


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda folder: flip(folder / VIDEO), "sha256 differs"),
        (lambda folder: cut(folder / VIDEO), "bytes long"),
        (lambda folder: flip(folder / LINES, b'"bytes":', b'"bytes": '), "another sha256"),
        (lambda folder: (folder / "videos/rig1/odd.mjpeg").write_bytes(b"x"), "not in the manifest"),
        (lambda folder: lengthen(folder / VIDEO), "frames in"),
    ],
)
def test_what_is_wrong_with_a_video_is_noticed(
    recording: Session, spoil: Callable[[Path], object], says: str
) -> None:
    spoil(recording.folder)
    assert any(says in str(problem) for problem in verify(Session.open(recording.folder)))


def test_frames_that_overlap_in_their_video_are_noticed(recording: Session) -> None:
    lines = [json.loads(line) for line in (recording.folder / LINES).read_bytes().splitlines()]
    lines[1]["offset"] -= 1
    (recording.folder / LINES).write_text("".join(json.dumps(line) + "\n" for line in lines))
    told = [str(problem) for problem in verify(Session.open(recording.folder))]
    assert f"{LINES}: frame 1 overlaps frame 0" in told
    assert not any("overlaps frame 1" in line for line in told)


@pytest.mark.parametrize(("broken", "is_noticed"), [(0, True), (1, False)])
def test_one_frame_in_some_is_decoded_and_the_first_of_all(
    tmp_path: Path, broken: int, is_noticed: bool
) -> None:
    """A broken encoder spoils all frames, and their checksums are of what it wrote."""
    with SessionWriter.create(tmp_path, "broken") as writer:
        save_frames(writer, frame("left", broken, jpeg(broken, 32, 24)[:-300]))
        session = record(writer)
    unreadable = [str(problem) for problem in verify(session) if problem.kind == "unreadable"]
    assert bool(unreadable) is is_noticed


def test_a_video_that_is_gone_is_one_thing_that_is_missing(
    recording: Session, capsys: pytest.CaptureFixture[str]
) -> None:
    (recording.folder / VIDEO).unlink()
    assert run(["sessions", "verify", str(recording.folder), "--json"]) == ExitCode.INCOMPLETE
    (told,) = json.loads(capsys.readouterr().out)["sessions"]
    missing = [one for one in told["problems"] if one["kind"] == "missing"]
    assert missing == [{"kind": "missing", "where": VIDEO, "what": "the video is missing"}]


def test_frames_that_cannot_be_read_are_refused(recording: Session) -> None:
    (recording.folder / LINES).write_bytes(b'{"offset": -1}\n')
    session = Session.open(recording.folder)
    with pytest.raises(BadInputError, match="does not hold the frames of a video"):
        verify(session)


def test_what_is_left_of_a_torn_line_moves_no_other(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path, "torn")
    save_frames(writer, *(frame("left", instant) for instant in range(3)))
    writer.abort()
    lines = tmp_path / "torn" / LINES
    first, second, third = lines.read_bytes().splitlines(keepends=True)
    lines.write_bytes(first + b"torn\r" + second + third)
    with SessionWriter(tmp_path / "torn", "torn") as resumed:
        left = [resumed.image("left", instant) for instant in range(3)]
        assert list(resumed.instants_of("left")) == [0, 2]
    assert [None if image is None else image.sha256 for image in left] == [
        hashlib.sha256(jpeg(0, 32, 24)).hexdigest(), None, hashlib.sha256(jpeg(2, 32, 24)).hexdigest(),
    ]  # fmt: skip
    assert lines.read_bytes() == first + third


def test_a_line_that_lacks_only_its_end_is_not_continued(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path, "torn")
    save_frames(writer, *(frame("left", instant) for instant in range(2)))
    writer.abort()
    lines = tmp_path / "torn" / LINES
    lines.write_bytes(lines.read_bytes()[:-1])
    with SessionWriter(tmp_path / "torn", "torn") as resumed:
        assert list(resumed.instants_of("left")) == [0]
        assert verify(record(resumed)) == []


def test_bytes_after_the_last_whole_frame_are_set_aside(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path, "torn")
    save_frames(writer, *(frame("left", instant) for instant in range(2)))
    writer.abort()
    video = next((tmp_path / "torn").rglob("*.mjpeg"))
    whole = video.read_bytes()
    lengthen(video)
    with SessionWriter(tmp_path / "torn", "torn"):
        assert video.read_bytes() == whole
    (aside,) = (tmp_path / "torn" / SET_ASIDE).rglob(f"{video.name}*")
    assert aside.read_bytes() == b"more"


def test_frames_after_the_end_of_a_recording_are_in_no_manifest(tmp_path: Path) -> None:
    with SessionWriter.create(tmp_path, "cut") as writer:
        save_frames(writer, *(frame("left", instant) for instant in (0, 2, 1)))
        assert [one.instant for one in writer.videos.in_order(2)] == [0, 1]


def test_a_video_that_a_person_has_deleted_has_no_further_frame(tmp_path: Path) -> None:
    with SessionWriter.create(tmp_path, "gone") as writer:
        save_frames(writer, frame("left", 0))
        (writer.folder / VIDEO).unlink()
        with pytest.raises(DiskError):
            writer.save([frame("left", 1)], in_videos=True)
        assert not writer.has("left", 1)


def flip(path: Path, old: bytes = b"", new: bytes = b"") -> None:
    data = path.read_bytes()
    middle = len(data) // 2
    flipped = data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :]
    path.write_bytes(data.replace(old, new, 1) if old else flipped)


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-10])


def lengthen(path: Path) -> None:
    path.write_bytes(path.read_bytes() + b"more")
