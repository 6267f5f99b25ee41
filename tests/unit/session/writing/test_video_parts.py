"""A camera's video in parts: where a disk has a largest file, a recording goes on in the next one."""

import os
from errno import EFBIG, EIO
from pathlib import Path

import pytest

from capture_app.common.errors import DiskError
from capture_app.session.format.manifest import video_of, video_path
from capture_app.session.library.listing import read_card
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verdict import frames_lost
from capture_app.session.reading.verify import verify
from capture_app.session.writing import video_store
from capture_app.session.writing.session_writer import SessionWriter
from tests.unit.session.conftest import jpeg
from tests.unit.session.recorded import frame, record, save_frames

PARTS = ["left.mjpeg", "left+2.mjpeg", "left+3.mjpeg"]


@pytest.fixture
def one_frame_a_part(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(video_store, "MAX_PART_BYTES", 1)


def check(session: Session) -> None:
    """See that the frames of all parts are images like others."""
    assert verify(session) == []
    images = session.manifest.images
    assert [(image.camera, image.instant) for image in images] == [
        ("left", 0), ("right", 0), ("left", 1), ("right", 1), ("left", 2),
    ]  # fmt: skip
    assert [session.image_bytes(image) for image in images] == [
        jpeg(image.instant, 32, 24) for image in images
    ]
    assert frames_lost(session.stored_manifest) == {"left": 0, "right": 1}
    assert read_card(session.folder).first_image == session.folder / "videos/rig1/left.mjpeg"


@pytest.mark.usefixtures("one_frame_a_part")
def test_frames_go_into_the_next_part_before_a_file_is_too_large(tmp_path: Path) -> None:
    session = record(SessionWriter.create(tmp_path, "walk"))
    videos = [video.path for video in session.stored_manifest.videos if video.camera == "left"]
    assert videos == [f"videos/rig1/{name}" for name in PARTS]
    check(session)


def largest_file(monkeypatch: pytest.MonkeyPatch, size: int, errno: int = EFBIG) -> None:
    def write_all(handle: int, data: bytes) -> None:
        if os.lseek(handle, 0, os.SEEK_CUR) + len(data) > size:
            os.write(handle, data[:1])
            raise OSError(errno, os.strerror(errno))
        os.write(handle, data)

    monkeypatch.setattr(video_store, "write_all", write_all)


def test_a_disk_with_a_smaller_largest_file_loses_no_frame(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    largest_file(monkeypatch, 2 * max(len(jpeg(n, 32, 24)) for n in range(3)))
    check(record(SessionWriter.create(tmp_path, "walk")))
    assert (tmp_path / "walk" / "videos" / "rig1" / "left+2.mjpeg").is_file()


@pytest.mark.parametrize(("size", "errno"), [(1, EFBIG), (2000, EIO)])
def test_a_frame_that_fits_into_no_file_and_a_broken_disk_are_errors(
    size: int, errno: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with SessionWriter.create(tmp_path, "walk") as writer:
        save_frames(writer, frame("left", 0))
        largest_file(monkeypatch, size, errno)
        with pytest.raises(DiskError):
            writer.save([frame("left", n) for n in (1, 2)], in_videos=True)
        assert [*writer.instants_of("left")] == [0]


def test_a_part_has_a_name_that_no_camera_has() -> None:
    for camera in ("left", "a.b", "left-2"):
        for part in (0, 1, 12):
            assert video_of(Path(video_path(camera, part)).stem) == (camera, part)
