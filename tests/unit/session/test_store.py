"""Sessions are written whole, read back as written, and never believed without a check."""

import errno
import io
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from capture_app.common import system
from capture_app.common.clock import SimulatedClock
from capture_app.common.errors import (
    BadInputError,
    DiskFullError,
    ExitCode,
    IncompleteError,
    SimulshotError,
    TryAgainError,
)
from capture_app.session.files.disk import disk_error
from capture_app.session.files.durable import PART, write_atomic
from capture_app.session.files.locks import lock_folder, lock_handle
from capture_app.session.format.manifest import (
    JOURNAL,
    MANIFEST,
    BurstRecord,
    ImageRecord,
    WidenedTimes,
    inside,
)
from capture_app.session.library.listing import list_sessions
from capture_app.session.reading.reader import Session, is_being_written
from capture_app.session.writing.session_writer import SessionWriter
from tests.project import ROOT

from .conftest import INSTANTS, calibration_of, camera_record, edit_manifest, fill, jpeg
from .recorded import frame


def test_what_is_written_is_read(session: Session) -> None:
    manifest = Session.open(session.folder).manifest
    assert manifest == session.manifest
    assert [(i.instant, i.camera) for i in manifest.images] == [
        (0, "left"), (0, "right"), (1, "left"), (1, "right"), (2, "left"),
    ]  # fmt: skip
    assert session.image_file(manifest.images[2]).read_bytes() == jpeg(1)
    assert [set(images) for images in session.images_by_instant()] == [{"left", "right"}] * 2 + [{"left"}]
    assert session.camera("right") == camera_record("right")
    assert session.ground_truth("left", 0) == session.folder / "ground_truth/left/000000.npz"
    assert session.ground_truth("left", 1) is None
    assert session.ground_truth("../left", 0) is None
    assert session.ground_truth("left", 10**400) is None
    times = session.true_times()
    assert times is not None
    assert times.images[0].true_ns == 77
    assert times.clocks == {"left": SimulatedClock(5)}
    assert not list(session.folder.rglob("*.part"))
    with pytest.raises(BadInputError, match=r"no camera 'top'.*left, right"):
        session.camera("top")


def test_a_label_beside_the_facts_is_read_as_theirs(session: Session) -> None:
    """As sessions had it at first."""
    edit_manifest(session, lambda manifest: manifest["cameras"][0].update(label="Böhm"))
    manifest = Session.open(session.folder).manifest
    assert manifest.labels == {"left": "Böhm", "right": "right"}
    stored = msgspec.json.decode(msgspec.json.encode(manifest))["cameras"][0]
    assert (stored["facts"]["label"], "label" in stored) == ("Böhm", False)


def test_calibration_is_kept(tmp_path: Path) -> None:
    calibration = calibration_of("left")
    writer = SessionWriter.create(tmp_path, "calibrated")
    writer.set_calibration(calibration)
    session = fill(writer)
    assert session.calibration() == calibration
    (session.folder / "calibration.json").write_text('{"schema_version": 2}')
    with pytest.raises(BadInputError, match="schema version 2"):
        session.calibration()


def test_many_images_are_in_the_session_after_one_sync(tmp_path: Path) -> None:
    with SessionWriter.create(tmp_path, "many") as writer:
        for instant in range(3):
            writer.add_image(jpeg(instant), camera="left", instant=instant, leader_ns=0, synced=False)
        with pytest.raises(BadInputError, match="already"):
            writer.add_image(jpeg(0), camera="left", instant=0, leader_ns=0, synced=False)
        assert writer.instants_of("left") == set()
        assert not (writer.folder / JOURNAL).read_bytes()
        writer.sync()
        assert writer.instants_of("left") == {0, 1, 2}
        assert (writer.folder / JOURNAL).read_bytes().count(b"\n") == 3


def test_an_image_whose_path_is_not_its_own_is_refused_with_its_batch(tmp_path: Path) -> None:
    first, second = (replace(frame("left", instant), true_ns=None) for instant in (0, 1))
    outside = replace(second, record=msgspec.structs.replace(second.record, path="../000001.jpg"))
    with SessionWriter.create(tmp_path, "small") as writer:
        with pytest.raises(BadInputError):
            writer.save([first, outside])
        assert [*tmp_path.rglob("*.jpg")] == []


def test_a_session_is_never_overwritten(session: Session) -> None:
    before = (session.folder / MANIFEST).read_bytes()
    with pytest.raises(BadInputError, match="exists already"):
        SessionWriter.create(session.folder.parent, "small")
    assert (session.folder / MANIFEST).read_bytes() == before


def test_two_writers_never_share_a_session(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path, "one")
    assert is_being_written(writer.folder)
    with pytest.raises(BadInputError, match="another process"):
        SessionWriter(writer.folder, "one")
    with pytest.raises(IncompleteError, match="still being written"):
        Session.open(writer.folder)
    writer.abort()
    assert not is_being_written(writer.folder)
    with pytest.raises(IncompleteError, match="incomplete"):
        Session.open(writer.folder)


def test_a_folder_that_was_moved_while_it_was_locked_is_not_kept_locked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(os.path, "samestat", lambda *_: False)
        with pytest.raises(TryAgainError):
            lock_folder(tmp_path)
    os.close(lock_folder(tmp_path))


def test_readers_that_look_for_a_writer_are_none(session: Session) -> None:
    another = system.open_folder(session.folder)
    lock_handle(another, shared=True)
    assert not is_being_written(session.folder)
    os.close(another)


def test_a_quota_that_is_used_up_is_a_full_disk(tmp_path: Path) -> None:
    used_up = OSError(errno.EDQUOT, "Disk quota exceeded")
    assert isinstance(disk_error(used_up, tmp_path), DiskFullError)


def test_what_a_crash_left_of_a_file_is_not_in_the_next_one(tmp_path: Path) -> None:
    (tmp_path / f"plan{PART}").write_bytes(b"what a crash left")
    write_atomic(tmp_path / "plan", b"new")
    assert (tmp_path / "plan").read_bytes() == b"new"


def test_abort_keeps_and_discard_deletes(tmp_path: Path) -> None:
    kept, gone = SessionWriter.create(tmp_path, "kept"), SessionWriter.create(tmp_path, "gone")
    for writer in (kept, gone):
        writer.add_image(b"picture", camera="cam0", instant=0, leader_ns=0)
    kept.abort()
    kept.abort()
    gone.discard()
    assert (kept.folder / "images/rig1/cam0/000000.jpg").read_bytes() == b"picture"
    assert not gone.folder.exists()
    with pytest.raises(BadInputError, match="closed"):
        kept.add_image(b"picture", camera="cam0", instant=1, leader_ns=0)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"camera": "../up"}, "is not a valid name for a camera"),
        ({"camera": "a\n"}, "is not a valid name for a camera"),
        ({"suffix": "/../../x.jpg"}, "not a supported image format"),
        ({"data": b""}, "empty image"),
        ({"instant": -1}, "instant"),
        ({"instant": 1, "gain": float("nan"), "uncertainty_ns": -1}, "uncertainty_ns"),
        ({}, "already"),
    ],
)
def test_bad_images_are_refused_and_leave_nothing(
    tmp_path: Path, changes: dict[str, object], reason: str
) -> None:
    writer = SessionWriter.create(tmp_path, "one")
    good = {"data": b"x", "camera": "cam0", "instant": 0, "leader_ns": 5}
    writer.add_image(**good)  # type: ignore[arg-type]
    with pytest.raises(BadInputError, match=reason):
        writer.add_image(**{**good, **changes})  # type: ignore[arg-type]
    writer.abort()
    assert len(list(tmp_path.rglob("*.jpg"))) == 1
    assert len((writer.folder / JOURNAL).read_bytes().splitlines()) == 1


@pytest.mark.parametrize("name", ["", ".", "..", "a/b", "/etc", "-x", "a" * 65, "a\0", "ä", "a b"])
def test_unsafe_session_names_are_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(BadInputError, match="is not a valid name for a session"):
        SessionWriter.create(tmp_path / "root", name)
    assert not (tmp_path / "root").exists()


def test_contradicting_records_leave_the_session_unfinished(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path, "one")
    writer.add_image(b"x", camera="cam0", instant=3, leader_ns=0)
    with pytest.raises(BadInputError, match="unknown instant, 3"):
        writer.finish([camera_record("cam0")], BurstRecord(instants_ns=INSTANTS, period_ns=1))
    with pytest.raises(BadInputError, match="unknown camera, cam0"):
        writer.finish([camera_record("cam1")], BurstRecord(instants_ns=(*INSTANTS, 2**40), period_ns=1))
    assert not (writer.folder / MANIFEST).exists()
    writer.finish([camera_record("cam0")], BurstRecord(instants_ns=(*INSTANTS, 2**40), period_ns=1))


def test_a_full_disk_is_said_plainly(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path, "one")
    (writer.folder / "images").write_text("in the way")
    with pytest.raises(SimulshotError, match="cannot write"):
        writer.add_image(b"x", camera="cam0", instant=0, leader_ns=0)
    writer.abort()


@pytest.mark.parametrize("path", ["nowhere", "empty", "file"])
def test_what_is_no_session_is_refused(tmp_path: Path, path: str) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").write_text("x")
    with pytest.raises(BadInputError) as caught:
        Session.open(tmp_path / path)
    assert caught.value.exit_code is ExitCode.BAD_INPUT
    assert path in str(caught.value)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b'{\n "name": "a",\n oops}', r"line 3 column \d"),
        (b"", "not valid JSON"),
        (b"\xff\xfe", "not valid JSON"),
        (b'{"new": ' + b"[" * 100_000, "JSON"),
        (b'{"schema_version": 1}', "missing required field `name`"),
        (b'{"schema_version": 2, "new": 1}', "newer simulshot"),
        (b"[]", "does not fit"),
    ],
    ids=["syntax", "empty", "bytes", "deep", "fields", "newer", "list"],
)
def test_broken_manifests_say_where(session: Session, content: bytes, reason: str) -> None:
    (session.folder / MANIFEST).write_bytes(content)
    with pytest.raises(BadInputError, match=reason):
        Session.open(session.folder)


@pytest.mark.parametrize(
    "path", ["../../secret", "/etc/passwd", "images/../../x", "images\\x", "", "images/\0", "loop/x", "out/x"]
)
def test_paths_out_of_the_session_are_refused(session: Session, tmp_path: Path, path: str) -> None:
    (tmp_path / "elsewhere").mkdir()
    (session.folder / "out").symlink_to(tmp_path / "elsewhere")
    (session.folder / "loop").symlink_to(session.folder / "loop")
    edit_manifest(session, lambda manifest: manifest["images"][0].update(path=path))
    with pytest.raises(BadInputError, match="outside the session"):
        Session.open(session.folder)


@pytest.mark.parametrize(("target", "allowed"), [("elsewhere", False), ("session.json", True)])
def test_a_linked_image_is_refused_if_it_is_elsewhere(
    session: Session, tmp_path: Path, target: str, allowed: bool
) -> None:
    (tmp_path / "elsewhere").write_bytes(b"secret")
    file = session.folder / session.manifest.images[0].path
    file.unlink()
    file.symlink_to((session.folder if allowed else tmp_path) / target)
    if allowed:
        Session.open(session.folder)
    else:
        with pytest.raises(BadInputError, match="outside the session"):
            Session.open(session.folder)


def test_images_are_not_looked_at_one_by_one(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    """Else a session of 100,000 images takes 6 s to open."""
    looked_at: list[str] = []

    def look(folder: Path, path: str) -> Path:
        looked_at.append(path)
        return inside(folder, path)

    monkeypatch.setattr("capture_app.session.format.manifest.inside", look)
    (session.folder / session.manifest.images[-1].path).unlink()
    opened = Session.open(session.folder)
    folders = {image.path.rpartition("/")[0] for image in session.manifest.images}
    assert sorted(looked_at) == sorted(folders)
    assert all(opened.image_file(image).is_file() for image in session.manifest.images[:-1])


def test_a_name_with_a_hidden_newline_is_refused(session: Session) -> None:
    edit_manifest(session, lambda manifest: manifest.update(rig="rig1\n"))
    with pytest.raises(BadInputError, match=r"matching regex.*rig"):
        Session.open(session.folder)


def test_an_image_of_nobody_is_refused(session: Session) -> None:
    edit_manifest(session, lambda manifest: manifest["images"][0].update(camera="nobody"))
    with pytest.raises(BadInputError, match=r"images\[0\] is of an unknown camera"):
        Session.open(session.folder)


def test_the_list_has_every_session_and_its_fate(session: Session, tmp_path: Path) -> None:
    SessionWriter.create(tmp_path, "unfinished").abort()
    fill(SessionWriter.create(tmp_path, "broken"))
    (tmp_path / "broken" / MANIFEST).write_text("{")
    (tmp_path / "other").mkdir()
    found = {one.name: one for one in list_sessions(tmp_path)}
    assert set(found) == {"small", "unfinished", "broken"}
    assert found["small"].images == 5
    assert found["small"].missing == 1
    assert not found["small"].problem
    assert "incomplete" in found["unfinished"].problem
    assert "JSON" in found["broken"].problem
    with pytest.raises(BadInputError, match="no folder"):
        list_sessions(tmp_path / "nowhere")


KILLED_WRITER = """
import pathlib, sys
from capture_app.session.writing.session_writer import SessionWriter
from tests.unit.session.writing.killed_writer import die_at
writer = SessionWriter.create(pathlib.Path(sys.argv[1]), "killed")
die_at(2 * int(sys.argv[2]) - 1)
for instant in range(1000):
    writer.add_image(bytes([instant % 256]) * 5000, camera="cam0", instant=instant, leader_ns=instant)
    print(instant, flush=True)
"""


@pytest.mark.parametrize("calls", [1, 9, 12])
def test_a_killed_writer_loses_nothing_it_promised(tmp_path: Path, calls: int) -> None:
    command = [sys.executable, "-c", KILLED_WRITER, str(tmp_path), str(calls)]
    child = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert child.returncode in (-9, 9), child.stderr  # 9: ended by TerminateProcess
    folder = tmp_path / "killed"
    lines = (folder / JOURNAL).read_bytes().splitlines()
    records = [msgspec.json.decode(line, type=ImageRecord) for line in lines]
    assert {int(done) for done in child.stdout.split()} <= {record.instant for record in records}
    for record in records:
        assert (folder / record.path).read_bytes() == bytes([record.instant % 256]) * 5000
    with pytest.raises(IncompleteError, match="incomplete"):
        Session.open(folder)
    assert not is_being_written(folder)


def test_an_image_is_as_unsure_as_its_camera_was_found_to_be_later(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path, "take")
    for instant, local_ns in enumerate((99, 100, 200, 201)):
        errors: dict[str, Any] = {"uncertainty_ns": 5, "hard_bound_ns": 70}
        times: dict[str, Any] = {"leader_ns": local_ns, "local_ns": local_ns}
        writer.add_image(jpeg(instant), camera="left", instant=instant, **times, **errors)
    doubt = WidenedTimes(
        from_local_ns=100, until_local_ns=200, uncertainty_ns=60, hard_bound_ns=65, reason="its clock stepped"
    )
    camera = msgspec.structs.replace(camera_record("left"), clock=None, widened=(doubt,))
    burst = BurstRecord(instants_ns=(0, 100, 200, 300), period_ns=100)
    images = writer.finish([camera], burst).manifest.images
    assert [image.uncertainty_ns for image in images] == [5, 60, 60, 5]
    assert [image.hard_bound_ns for image in images] == [70, 70, 70, 70], "of two bounds the larger one holds"


def test_true_depth_is_unknown_where_it_is_infinite(tmp_path: Path) -> None:
    truth = io.BytesIO()
    np.savez(truth, depth_m=np.array([[1.5, np.inf], [np.nan, 0.0]]), movers=np.array([[0, 1], [2, 0]]))
    writer = SessionWriter.create(tmp_path, "take")
    writer.add_image(jpeg(0), camera="left", instant=0, leader_ns=0, truth=truth.getvalue(), true_ns=7)
    session = writer.finish([camera_record("left")], BurstRecord(instants_ns=(0,), period_ns=100))
    known = session.read_ground_truth("left", 0)
    assert known is not None
    np.testing.assert_array_equal(known[0], [[1.5, 0], [0, 0]])
    np.testing.assert_array_equal(known[1], [[False, True], [True, False]])
    assert session.read_ground_truth("left", 1) is None
