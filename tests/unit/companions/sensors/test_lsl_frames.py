"""What the Lab Streaming Layer's stream reads of a session that is being written."""

from pathlib import Path

import pytest

from capture_app.companions.sensors.lsl_frames import _Tail
from capture_app.session.writing import video_store
from capture_app.session.writing.session_writer import SessionWriter
from tests.unit.session.recorded import frame, save_frames


def test_frames_in_further_parts_of_a_video_are_their_cameras(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(video_store, "MAX_PART_BYTES", 1)
    with SessionWriter.create(tmp_path, "walk") as writer:
        save_frames(writer, frame("left", 0), frame("right", 0), frame("left", 1))
        tail = _Tail()
        assert {(image.camera, image.instant) for image in tail.new_records(writer.folder)} == {
            ("left", 0), ("right", 0), ("left", 1),
        }  # fmt: skip
        save_frames(writer, frame("left", 2))
        assert [(image.camera, image.instant) for image in tail.new_records(writer.folder)] == [("left", 2)]


def test_a_renamed_session_is_read_on(tmp_path: Path) -> None:
    with SessionWriter.create(tmp_path, "walk") as writer:
        tail = _Tail()
        save_frames(writer, frame("left", 0))
        assert [image.instant for image in tail.new_records(writer.folder)] == [0]
        (tmp_path / "walk").rename(tmp_path / "run")
        save_frames(writer, frame("left", 1))
        assert [image.instant for image in tail.new_records(writer.folder)] == [1]
