"""Sessions from strangers: whatever is in them is read, or refused in a sentence."""

import copy
import json
import os
import struct
import zlib
from contextlib import suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from capture_app.cli import run
from capture_app.common.errors import ExitCode, SimulshotError
from capture_app.companions.importing.import_options import ImportOptions
from capture_app.session.format.manifest import CALIBRATION, JOURNAL, MANIFEST
from capture_app.session.reading.checksums import CHECKSUMS
from capture_app.session.reading.decoding import image_size
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from tests.imported import import_one

from .conftest import jpeg


def changed(content: Any, path: tuple[Any, ...], value: Any) -> Any:
    new = copy.deepcopy(content)
    at = new
    for key in path[:-1]:
        at = at[key]
    at[path[-1]] = value
    return new


@pytest.mark.parametrize("command", ["show", "verify", "list"])
@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("burst", "instants_ns"), []),
        (("burst", "instants_ns"), [1_000_000_000]),
        (("sync", "spread_ns"), [1]),
        (("cameras", 0, "clock", "skew_ppm"), 1e308),
        (("images", 0, "leader_ns"), 2**80),
        (("images",), []),
        (("cameras",), []),
    ],
)
def test_commands_say_what_is_wrong_in_a_sentence(
    session: Session, command: str, path: tuple[Any, ...], value: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    content = json.loads((session.folder / MANIFEST).read_text())
    (session.folder / MANIFEST).write_text(json.dumps(changed(content, path, value)))
    where = session.folder.parent if command == "list" else session.folder
    assert run(["sessions", command, str(where)]) in (ExitCode.OK, ExitCode.BAD_INPUT)
    said = capsys.readouterr()
    assert "Traceback" not in said.err
    assert len(said.err.splitlines()) <= 1


def test_a_session_of_no_camera_is_refused_before_it_is_shown(
    session: Session, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content = json.loads((session.folder / MANIFEST).read_text())
    content |= {"cameras": [], "images": [], "missing": [], "sync": None}
    (session.folder / MANIFEST).write_text(json.dumps(content))
    for command, out in (("sheet", "sheet.jpg"), ("wiggle", "wiggle.gif")):
        told = ["sessions", command, str(session.folder), "--out", str(tmp_path / out)]
        assert run(told) == ExitCode.BAD_INPUT
        assert "has no cameras" in capsys.readouterr().err


@pytest.mark.parametrize("name", [MANIFEST, JOURNAL, CALIBRATION, CHECKSUMS, "images/rig1/left/000000.jpg"])
def test_a_pipe_in_a_session_keeps_nobody_waiting(session: Session, name: str) -> None:
    path = session.folder / name
    path.unlink(missing_ok=True)
    os.mkfifo(path)
    with suppress(SimulshotError):
        assert verify(Session.open(session.folder)) != []


def test_a_small_file_of_a_huge_picture_is_not_decoded(session: Session) -> None:
    """Zeros compress a thousandfold: 60,000 pixels square would take 11 GB."""
    body = b"IHDR" + struct.pack(">IIBBBBB", 60_000, 60_000, 8, 2, 0, 0, 0)
    bomb = b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + body + struct.pack(">I", zlib.crc32(body))
    assert image_size(bomb) is None
    path = session.image_file(session.manifest.images[0])
    path.write_bytes(bomb)
    said = [str(problem) for problem in verify(session)]
    assert any("60000x60000 pixels; left takes 16x12" in line for line in said)


def test_a_cut_jpeg_has_no_size() -> None:
    data = turned_jpeg(1)
    assert image_size(data) == (16, 12)
    assert image_size(data[: len(data) // 4]) is None


def turned_jpeg(orientation: int) -> bytes:
    """A picture of 16 x 12 pixels, bright at its top left, whose EXIF says how to turn it."""
    pixels = np.zeros((12, 16, 3), np.uint8)
    pixels[:6, :8] = 255
    data = bytes(cv2.imencode(".jpg", pixels)[1].tobytes())
    tiff = b"II*\0" + struct.pack("<IHHHII", 8, 1, 0x0112, 3, 1, orientation) + bytes(4)
    segment = b"Exif\0\0" + tiff
    return data[:2] + b"\xff\xe1" + struct.pack(">H", len(segment) + 2) + segment + data[2:]


@pytest.mark.parametrize(
    ("orientation", "size", "bright"),
    [(1, (16, 12), (2, 2)), (3, (16, 12), (9, 13)), (6, (12, 16), (2, 9)), (8, (12, 16), (13, 2))],
)
def test_pictures_are_turned_by_their_exif_as_they_are_imported(
    tmp_path: Path, orientation: int, size: tuple[int, int], bright: tuple[int, int]
) -> None:
    for camera, data in (("a", turned_jpeg(orientation)), ("b", jpeg(1))):
        (tmp_path / camera).mkdir()
        (tmp_path / camera / "0.jpg").write_bytes(data)
    cameras = [f"{name}={tmp_path / name}" for name in ("a", "b")]
    made = import_one(cameras, tmp_path / "out", "taken", ImportOptions(fps=30.0))
    assert verify(made) == []
    (record,) = (image for image in made.manifest.images if image.camera == "a")
    file = made.image_file(record)
    plain = cv2.imread(str(file), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    turned = cv2.imread(str(file), cv2.IMREAD_COLOR)
    assert (plain.shape[1], plain.shape[0]) == size
    assert np.array_equal(plain, turned), "nobody turns it again"
    assert plain[bright].mean() > 200
    assert plain.mean() < 120
    if orientation == 1:
        assert file.read_bytes() == turned_jpeg(1), "its bytes are kept"
