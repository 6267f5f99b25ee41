"""Folders as strangers have them become sessions by one command without an option."""

import os
import struct
from pathlib import Path

import av
import numpy as np

from capture_app.cli import run
from capture_app.common.errors import ExitCode
from capture_app.companions.importing.clips import find_shoots
from tests.unit.companions.importing.numbered_video import write_video


def test_what_cannot_be_read_in_a_folder_of_a_folder_is_said_once(tmp_path: Path) -> None:
    for name in ("left.mp4", "right.mp4"):
        write_video(tmp_path / "card" / name, (0, 33_000, 66_000))
    (tmp_path / "card" / "broken.mp4").write_bytes(b"no video")
    shoots, left_out = find_shoots(tmp_path)
    assert [sorted(clips) for _, clips in shoots] == [["left", "right"]]
    assert left_out == ["left out broken.mp4: it cannot be decoded"]


def test_a_clip_whose_date_no_other_camera_writes_so_is_a_clip_without_a_date(tmp_path: Path) -> None:
    """As FFmpeg hands on an AVI's IDIT chunk with slashes, whatever else is in it."""
    path = tmp_path / "left.avi"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=30)
        container.mux(stream.encode(av.VideoFrame.from_ndarray(np.zeros((64, 64, 3), np.uint8))))
        container.mux(stream.encode(None))
    data, text = path.read_bytes(), b"2005/08/17/ 11:42\0"
    chunk = b"IDIT" + struct.pack("<I", len(text)) + text
    head = data.index(b"LIST")
    begin = data.index(b"avih") + 8 + int.from_bytes(data[head + 16 : head + 20], "little")
    path.write_bytes(
        b"RIFF" + struct.pack("<I", len(data) - 8 + len(chunk)) + data[8 : head + 4]
        + struct.pack("<I", int.from_bytes(data[head + 4 : head + 8], "little") + len(chunk))
        + data[head + 8 : begin] + chunk + data[begin:]
    )  # fmt: skip
    with av.open(str(path)) as container:
        assert container.metadata["creation_time"] == "2005-08-17/ 11:42"
    shoots, left_out = find_shoots(tmp_path)
    assert left_out == []
    assert [clip.began_s for clip in shoots[0][1].values()] == [None]


def test_what_is_imported_and_exported_is_for_its_owner_and_group(tmp_path: Path) -> None:
    before = os.umask(0o022)
    try:
        write_video(tmp_path / "clip.mp4", (0, 33_000, 66_000))
        out, exported = tmp_path / "out", tmp_path / "exported"
        clip = [str(tmp_path / "clip.mp4"), "--name", "s"]
        assert run(["sessions", "import", *clip, "--out", str(out)]) == ExitCode.OK
        assert (
            run(["sessions", "export", str(out / "s"), "--to", "colmap", "--out", str(exported)])
            == ExitCode.OK
        )
    finally:
        os.umask(before)
    made = [path for root in (out / "s", exported) for path in (root, *root.rglob("*"))]
    modes = {(path.is_dir(), path.stat().st_mode & 0o777) for path in made}
    assert modes == {(True, 0o750), (False, 0o640)}
