"""What an interrupted writer left: whatever is whole is kept, and the rest is out of the way."""

import hashlib
import json
import os
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import pytest
from msgspec import structs

from capture_app.common.errors import BadInputError, DiskFullError, SimulshotError
from capture_app.session.format.burst_plan import InstantRange, read_plan
from capture_app.session.format.journal import TRUE_TIMES_JOURNAL, ground_truth_path
from capture_app.session.format.manifest import JOURNAL, MANIFEST
from capture_app.session.writing import image_store, session_writer
from capture_app.session.writing.recovery import INCOMING, RESERVE, SET_ASIDE
from capture_app.session.writing.session_writer import SessionWriter
from tests.unit.session.conftest import CLOCK, camera_record
from tests.unit.session.recorded import frame, record
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


def test_an_image_that_finds_no_room_is_said_to(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """That there is no file of it to delete is no error."""

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    with SessionWriter.create(tmp_path, "small") as writer:
        monkeypatch.setattr(image_store, "write_atomic", full)
        with pytest.raises(DiskFullError):
            writer.save([replace(frame("left", 0), true_ns=None)])
