"""What an interrupted writer left: whatever is whole is kept, and the rest is out of the way."""

import hashlib
import json
import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import pytest
from msgspec import structs

from capture_app.cli import run
from capture_app.common.errors import BadInputError, SimulshotError
from capture_app.session.format.burst_plan import CameraPlan, InstantRange, read_plan
from capture_app.session.format.journal import TRUE_TIMES_JOURNAL, ground_truth_path
from capture_app.session.format.manifest import JOURNAL, MANIFEST, MissingImage
from capture_app.session.reading.checksums import changed_files
from capture_app.session.reading.reader import INCOMING, Session, writing_state
from capture_app.session.reading.verify import verify
from capture_app.session.writing import session_writer
from capture_app.session.writing.recovery import RESERVE, SET_ASIDE
from capture_app.session.writing.session_writer import SessionWriter
from tests.unit.session.conftest import CLOCK, calibration_of, camera_record
from tests.unit.session.recorded import frame, record, save_frames
from tests.unit.session.writing.full_take import PERIOD_NS, Take


def interrupted(root: Path, images: int) -> Take:
    """A take whose writer ended after so many images."""
    take = Take(root)
    with take.begin() as writer:
        for name, instant in take.places[:images]:
            take.add(writer, name, instant)
    return take


def test_true_times_outlive_a_crash_where_they_are_whole(tmp_path: Path) -> None:
    take = interrupted(tmp_path, 4)
    journal = take.folder / TRUE_TIMES_JOURNAL
    journal.write_bytes(journal.read_bytes()[:-9])
    (take.folder / ground_truth_path("cam1", 0)).write_bytes(b"damaged")
    with SessionWriter.resume(take.folder) as writer:
        assert [*writer.images.true_times] == [("cam0", 0), ("cam0", 1)]
        take.add(writer, "cam0", 2)
    with SessionWriter.resume(take.folder) as writer:
        assert [*writer.images.true_times] == [("cam0", 0), ("cam0", 1), ("cam0", 2)]


def test_a_captured_session_has_no_true_times(tmp_path: Path) -> None:
    with SessionWriter.create(tmp_path, "captured") as writer:
        writer.save([replace(frame("left", 0), true_ns=None)])
        assert writer.images.write_truth() == ()


def test_no_path_of_a_journal_leads_out_of_the_session(tmp_path: Path) -> None:
    take = interrupted(tmp_path, 2)
    outside, journal = tmp_path / "000000.jpg", take.folder / JOURNAL
    outside.write_bytes(take.confirmed["cam0", 0])
    first, second = map(json.loads, journal.read_text().splitlines())
    journal.write_text("\n".join(map(json.dumps, (first | {"path": "../000000.jpg"}, second))) + "\n")
    with SessionWriter.resume(take.folder) as writer:
        assert [*writer.images.records] == [("cam1", 0)]
    assert outside.exists()


def test_a_half_written_image_is_deleted_and_a_foreign_file_is_set_aside(tmp_path: Path) -> None:
    take = interrupted(tmp_path, 1)
    for name in ("000001.jpg.part", "000001.jpg"):
        (take.folder / "images/rig1/cam0" / name).write_bytes(b"x")
    SessionWriter.resume(take.folder).abort()
    assert [path.name for path in (take.folder / "images").rglob("*.*")] == ["000000.jpg"]
    assert [path.name for path in (take.folder / SET_ASIDE).rglob("*.*")] == ["000001.jpg"]
    (take.folder / "images/rig1/cam0/000001.jpg").write_bytes(b"y")
    SessionWriter.resume(take.folder).abort()
    aside = (take.folder / SET_ASIDE).rglob("*.*")
    assert sorted(path.read_bytes() for path in aside) == [b"x", b"y"], "both are kept"


def test_an_intact_manifest_is_believed_where_the_journal_says_otherwise(tmp_path: Path) -> None:
    take = Take(tmp_path)
    journal = take.write().folder / JOURNAL
    first, *others = map(json.loads, journal.read_text().splitlines())
    altered = first | {"sha256": "0" * 64}
    journal.write_text("\n".join(map(json.dumps, (altered, *others))) + "\n")
    with SessionWriter.resume(take.folder) as writer:
        assert {*writer.images.records} == {*take.places}
    assert not (take.folder / SET_ASIDE).exists()


def test_images_of_a_manifest_that_a_newer_version_wrote_are_those_of_the_journal(tmp_path: Path) -> None:
    take = Take(tmp_path)
    manifest, sums = take.write().folder / MANIFEST, take.folder / "checksums.sha256"
    old = manifest.read_bytes()
    manifest.write_bytes(b'{"schema_version": 99}')
    before, after = (hashlib.sha256(data).hexdigest() for data in (old, manifest.read_bytes()))
    sums.write_text(sums.read_text().replace(before, after))
    with SessionWriter.resume(take.folder) as writer:
        assert {*writer.images.records} == {*take.places}


def test_a_finished_session_that_is_resumed_says_so_until_it_is_written_again(tmp_path: Path) -> None:
    take = Take(tmp_path)
    take.write()
    writer = SessionWriter.resume(take.folder)
    assert (take.folder / INCOMING).is_dir()
    take.end(writer)
    assert not (take.folder / INCOMING).exists()


@pytest.mark.parametrize("step", ["write_checksums", "sync_all", "write_atomic"])
def test_a_resumed_session_says_so_at_whatever_step_it_is_killed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    take = Take(tmp_path)
    take.write()
    writer = SessionWriter.resume(take.folder)
    monkeypatch.setattr(session_writer, step, Mock(side_effect=KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        take.end(writer)
    writer.abort()
    assert (take.folder / INCOMING).is_dir()


@pytest.fixture
def late(tmp_path: Path) -> Iterator[SessionWriter]:
    """A finished recording, opened again."""
    with SessionWriter.create(tmp_path, "late") as writer:
        plan = read_plan(Take(tmp_path / "of").write().folder)
        cameras = [camera_record(name, width=32, height=24) for name in ("left", "right")]
        parts = tuple(CameraPlan(camera=camera) for camera in cameras)
        writer.set_plan(structs.replace(plan, name="late", cameras=parts))
        writer.add_event({"event": "joined"})
        record(writer)
    with SessionWriter.resume(tmp_path / "late") as writer:
        yield writer


def add_late_images(writer: SessionWriter) -> None:
    assert writer.plan is not None
    writer.set_plan(structs.replace(writer.plan, note="another report came"))
    writer.add_event({"event": "joined"})
    save_frames(writer, frame("right", 2))


def test_a_session_is_verified_as_it_was_finished_while_late_images_arrive(late: SessionWriter) -> None:
    before = Session.open(late.folder)
    assert (writing_state(late.folder), verify(before)) == ("reopened", [])
    images = before.manifest.images
    add_late_images(late)
    for lines in (JOURNAL, "videos/rig1/right.frames.ndjson"):
        with (late.folder / lines).open("ab") as file:
            file.write(b'{"half a line')
    opened = Session.open(late.folder)
    assert opened.is_arriving
    assert verify(opened) == []
    assert opened.manifest.images == images, "all readers see what its manifest counts"


@pytest.mark.parametrize(
    ("path", "before", "after"),
    [
        ("videos/rig1/left.mjpeg", b"JFIF", b"JFIX"),
        ("videos/rig1/left.frames.ndjson", b'"uncertainty_ns":20000', b'"uncertainty_ns":20001'),
        ("events.ndjson", b"joined", b"joinet"),
    ],
)
def test_damage_is_found_while_late_images_arrive(
    late: SessionWriter, path: str, before: bytes, after: bytes
) -> None:
    add_late_images(late)
    data = (late.folder / path).read_bytes()
    assert before in data
    (late.folder / path).write_bytes(data.replace(before, after, 1))
    found = verify(Session.open(late.folder))
    assert ("changed", path) in {(one.kind, one.where.partition("#")[0]) for one in found}


def test_a_video_that_is_shorter_than_it_was_is_found_while_late_images_arrive(late: SessionWriter) -> None:
    os.truncate(late.folder / "videos/rig1/left.mjpeg", 100)
    assert any("frames in 100 bytes" in str(problem) for problem in verify(Session.open(late.folder)))


def test_late_images_of_a_burst_are_not_what_was_finished(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    take = interrupted(tmp_path, 5)
    with SessionWriter.resume(take.folder) as writer:
        take.end(writer, MissingImage(camera="cam1", instant=2, reason="it is away"))
    with SessionWriter.resume(take.folder) as writer:
        take.add(writer, "cam1", 2)
        writer.set_calibration(calibration_of("cam1"))
        opened = Session.open(take.folder)
        assert (len(opened.manifest.images), verify(opened)) == (5, [])
        assert run(["sessions", "verify", str(take.folder)]) == 0
        assert "all 5 images are intact; further ones are still arriving" in capsys.readouterr().out
        take.end(writer)
    assert verify(Session.open(take.folder)) == []


def test_a_session_whose_leader_ended_as_late_images_arrived_says_so(late: SessionWriter) -> None:
    add_late_images(late)
    late.abort()
    assert writing_state(late.folder) == "interrupted again"
    assert [str(problem) for problem in verify(Session.open(late.folder))] == [
        "incoming: its leader ended while late images arrived"
    ]


def test_a_session_that_is_finished_while_it_is_verified_is_verified_anew(
    late: SessionWriter, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = Session.open(late.folder)
    add_late_images(late)
    finished: list[Session] = []

    def found(folder: Path, *, is_open: bool) -> Iterator[tuple[str, str]]:
        if not finished:
            cameras = [camera_record(name, width=32, height=24) for name in ("left", "right")]
            finished.append(late.finish(cameras, opened.manifest.burst))
            yield MANIFEST, "its bytes have changed"
        yield from changed_files(folder, is_open=is_open)

    monkeypatch.setattr("capture_app.session.reading.verify.changed_files", found)
    assert verify(opened) == []
    assert len(finished) == 1


def test_a_plan_reserves_room_for_its_manifest_once(tmp_path: Path) -> None:
    take = Take(tmp_path)
    with take.begin() as writer:
        plan = writer.plan
        assert plan is not None
        reserved = (take.folder / RESERVE).stat().st_size
        of_images = session_writer.RESERVED_BYTES_PER_IMAGE * len(take.places)
        assert reserved == session_writer.RESERVED_BYTES + of_images
        (take.folder / RESERVE).unlink()
        writer.set_plan(plan)
        assert not (take.folder / RESERVE).exists()
    with SessionWriter.create(tmp_path, "video") as writer:
        streamed = InstantRange(first_ns=0, step_ns=PERIOD_NS, count=900, video=True)
        writer.set_plan(structs.replace(plan, streamed=streamed))
        of_instants = session_writer.RESERVED_BYTES_PER_INSTANT * 900
        assert (writer.folder / RESERVE).stat().st_size == session_writer.RESERVED_BYTES + of_instants


def test_a_plan_that_a_full_disk_did_not_take_is_saved_with_the_manifest(tmp_path: Path) -> None:
    take = Take(tmp_path)
    writer = take.begin()
    assert writer.plan is not None
    take.add(writer, "cam0", 0)
    plan = structs.replace(writer.plan, cameras=writer.plan.cameras[:1])
    writer.finish([camera_record("cam0")], take.burst, plan=plan)
    assert [part.camera.name for part in read_plan(take.folder).cameras] == ["cam0"]


def test_a_session_whose_cameras_are_all_invalid_is_not_finished(tmp_path: Path) -> None:
    take = Take(tmp_path)
    with take.begin() as writer:
        invalid = structs.replace(camera_record("cam0"), clock=structs.replace(CLOCK, offset_ns=2**63))
        with pytest.raises(BadInputError, match="no camera has a valid record: cam0 is left out"):
            writer.finish([invalid], take.burst)


def test_a_writer_that_ends_keeps_no_file_open(tmp_path: Path) -> None:
    def still_open() -> list[str]:
        names = [os.path.realpath(link) for link in Path("/proc/self/fd").iterdir()]
        return [name for name in names if name.startswith(str(tmp_path))]

    Take(tmp_path).write()
    record(SessionWriter.create(tmp_path, "recording"))
    interrupted(tmp_path / "interrupted", 2)
    SessionWriter.create(tmp_path, "discarded").discard()
    assert still_open() == []
    (tmp_path / "interrupted/take" / JOURNAL).unlink()
    (tmp_path / "interrupted/take" / JOURNAL).mkdir()
    with pytest.raises(SimulshotError):
        SessionWriter.resume(tmp_path / "interrupted/take")
    assert still_open() == []


def test_a_session_that_the_disk_refuses_leaves_no_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_: Path) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(session_writer, "sync_folder", full)
    with pytest.raises(SimulshotError):
        SessionWriter.create(tmp_path, "refused")
    assert not (tmp_path / "refused").exists()
