"""The film of a recording in its node's spool: appended, read, and deleted when the leader has it."""

from pathlib import Path

import pytest

from capture_app.common.errors import DiskFullError
from capture_app.node.camera import film_spool
from capture_app.node.camera.film_spool import SpooledFilm
from capture_app.protocol.messages import ImageUpload
from capture_app.session.files.durable import write_all
from tests.unit.node.bursts import IMAGE, upload

FRAMES = [(upload("a", instant), IMAGE) for instant in range(6)]


def headers(*instants: int) -> list[ImageUpload]:
    return [FRAMES[instant][0] for instant in instants]


def files(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_segments_are_deleted_when_the_leader_has_all_their_frames(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(film_spool, "SEGMENT_BYTES", 2 * len(IMAGE))
    film = SpooledFilm(tmp_path)
    for number in range(0, 6, 2):
        film.append(FRAMES[number : number + 2])
    assert files(tmp_path) == [f"{n:06d}{suffix}" for n in (1, 2, 3) for suffix in (".film", ".ndjson")]
    assert film.read(headers(0, 3, 5)) == [IMAGE] * 3
    assert film.release([0, 2, 3]) == [tmp_path / "000002.film", tmp_path / "000002.ndjson"]
    assert film.release([4, 5]) == [], "frames may still be appended to the last one"
    assert film.read(headers(1, 2)) == [IMAGE, None]
    film.close()


def test_a_killed_node_offers_the_frames_whose_bytes_and_lines_are_there(tmp_path: Path) -> None:
    film = SpooledFilm(tmp_path)
    film.append(FRAMES[:4])
    film.close()
    path, index = tmp_path / "000001.film", tmp_path / "000001.ndjson"
    lines = index.read_bytes().splitlines(keepends=True)
    index.write_bytes(lines[0] + b"\0" * len(lines[1]) + b"\n" + b"".join(lines[2:]) + b'{"offset":')
    with path.open("r+b") as cut:
        cut.truncate(3 * len(IMAGE) + 1)
    again = SpooledFilm(tmp_path)
    assert [frame.record.instant for frame in again.recover()] == [0, 2]
    assert again.read(headers(0, 2)) == [IMAGE, IMAGE]
    again.append(FRAMES[4:5])
    assert (tmp_path / "000002.film").read_bytes() == IMAGE, "what was left is not appended to"
    again.close()


def test_frames_that_a_full_disk_refuses_leave_the_earlier_ones_readable(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    film = SpooledFilm(tmp_path)
    film.append(FRAMES[:1])
    written: list[bytes] = []

    def fill(handle: int, data: bytes) -> None:
        if written:
            raise OSError(28, "No space left on device")
        written.append(data)
        write_all(handle, data)

    with monkeypatch.context() as full:
        full.setattr("capture_app.node.camera.film_spool.write_all", fill)
        with pytest.raises(DiskFullError):
            film.append(FRAMES[1:3])
    assert (tmp_path / "000001.film").read_bytes() == IMAGE
    film.append(FRAMES[3:4])
    assert film.read(headers(0, 1, 3)) == [IMAGE, None, IMAGE]
    film.close()
    assert [frame.record.instant for frame in SpooledFilm(tmp_path).recover()] == [0, 3]
    assert film.release([1, 2]) == [], "they were never there"
    assert film.release([0]) == [tmp_path / "000001.film", tmp_path / "000001.ndjson"]


def test_a_frame_that_a_disk_has_lost_in_part_is_not_there(tmp_path: Path) -> None:
    film = SpooledFilm(tmp_path)
    film.append(FRAMES[:2])
    with (tmp_path / "000001.film").open("r+b") as cut:
        cut.truncate(2 * len(IMAGE) - 1)
    assert film.read(headers(0, 1)) == [IMAGE, None]
    film.close()
