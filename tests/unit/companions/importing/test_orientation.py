"""Pictures whose EXIF turns them are upright in a session, and equal for both packages."""

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from capture_app.companions.importing.import_options import ImportOptions
from capture_app.session.reading.decoding import decode_image, rotate_upright
from capture_app.session.reading.verify import verify
from reconstruction.common.image_files import read_image
from tests.imported import import_one

ENDS = {1: "upright", 2: "mirrored", 3: "upside down", 6: "on its side", 8: "on its other side"}


def turned(orientation: int) -> np.ndarray:
    """A picture that is stored so that its red corner is at the upper left when it is shown."""
    stored = np.full((32, 48, 3), 60, np.uint8)
    top, left = {1: (0, 0), 2: (0, 40), 3: (24, 40), 6: (24, 0), 8: (0, 40)}[orientation]
    stored[top : top + 8, left : left + 8] = (0, 0, 255)
    return stored


def with_orientation(picture: np.ndarray, suffix: str, orientation: int) -> bytes:
    """The file of a picture with an EXIF of one field (PNG 3rd edition, eXIf; TIFF 6.0)."""
    data = cv2.imencode(suffix, picture)[1].tobytes()
    tiff = b"II*\0" + struct.pack("<IHHHIHHI", 8, 1, 0x0112, 3, 1, orientation, 0, 0)
    if suffix == ".jpg":
        body = b"Exif\0\0" + tiff
        return data[:2] + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + data[2:]
    if suffix == ".png":
        body = b"eXIf" + tiff
        return (
            data[:33] + struct.pack(">I", len(tiff)) + body + struct.pack(">I", zlib.crc32(body)) + data[33:]
        )
    (first,) = struct.unpack_from("<I", data, 4)
    (count,) = struct.unpack_from("<H", data, first)
    entries = [data[first + 2 + 12 * n : first + 14 + 12 * n] for n in range(count)]
    entries = [entry for entry in entries if entry[:2] != struct.pack("<H", 0x0112)]
    entries.append(struct.pack("<HHIHH", 0x0112, 3, 1, orientation, 0))
    directory = struct.pack("<H", len(entries)) + b"".join(sorted(entries)) + bytes(4)
    return data[:4] + struct.pack("<I", len(data)) + data[8:] + directory


@pytest.mark.parametrize("orientation", ENDS, ids=ENDS.values())
@pytest.mark.parametrize("suffix", [".jpg", ".png", ".tif"])
def test_a_picture_is_upright_for_both_packages(suffix: str, orientation: int, tmp_path: Path) -> None:
    for camera in ("a", "b"):
        (tmp_path / "rec" / camera).mkdir(parents=True)
        data = with_orientation(turned(orientation), suffix, orientation)
        (tmp_path / "rec" / camera / f"0{suffix}").write_bytes(data)
    session = import_one([str(tmp_path / "rec")], tmp_path, "s", ImportOptions(fps=30))
    assert verify(session) == []
    path = session.image_file(session.manifest.images[0])
    pictures = read_image(path), decode_image(path.read_bytes(), colour=True)
    for picture in pictures:
        assert picture is not None
        assert picture.shape == ((32, 48, 3) if orientation < 5 else (48, 32, 3))
        assert picture[3, 3].tolist() == pytest.approx([0, 0, 255], abs=30)
        assert picture[-4, -4].tolist() == pytest.approx([60, 60, 60], abs=30)
    assert np.array_equal(*pictures)


def test_a_stored_orientation_turns_nothing_later(tmp_path: Path) -> None:
    """As in a session of before: the bytes of its pictures stay, and both packages show them as stored."""
    path = tmp_path / "0.png"
    path.write_bytes(with_orientation(turned(6), ".png", 6))
    assert np.array_equal(read_image(path), turned(6))
    assert np.array_equal(decode_image(path.read_bytes(), colour=True), turned(6))


def test_all_eight_orientations_are_those_of_exif() -> None:
    """The first row and column of the stored picture, as EXIF 2.32 names them."""
    stored = np.arange(6, dtype=np.uint8).reshape(2, 3)
    shown = {
        1: [[0, 1, 2], [3, 4, 5]], 2: [[2, 1, 0], [5, 4, 3]], 3: [[5, 4, 3], [2, 1, 0]],
        4: [[3, 4, 5], [0, 1, 2]], 5: [[0, 3], [1, 4], [2, 5]], 6: [[3, 0], [4, 1], [5, 2]],
        7: [[5, 2], [4, 1], [3, 0]], 8: [[2, 5], [1, 4], [0, 3]],
    }  # fmt: skip
    for orientation, expected in shown.items():
        assert rotate_upright(stored, orientation).tolist() == expected, orientation
