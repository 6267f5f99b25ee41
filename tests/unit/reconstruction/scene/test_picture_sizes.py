"""Sizes are read from a picture's header, and nothing is decoded that would not fit into memory."""

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from capture_app.common.errors import BadInputError
from capture_app.session.reading.decoding import size_of
from capture_app.session.reading.reader import Session
from reconstruction.common.image_files import image_size, read_image
from reconstruction.common.memory import ByteCache, limited_memory
from reconstruction.scene.calibration.soundness import calibrated_views
from reconstruction.scene.dataset import Dataset


def empty_png(width: int, height: int) -> bytes:
    """A PNG's header without its pixels."""
    body = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + body + struct.pack(">I", zlib.crc32(body))


@pytest.mark.parametrize("suffix", ["png", "jpg", "tif", "bmp", "webp"])
@pytest.mark.parametrize("size", [(61, 33), (300, 1000)])
def test_the_header_tells_the_size(tmp_path: Path, suffix: str, size: tuple[int, int]) -> None:
    image = np.random.default_rng(1).integers(0, 255, (size[1], size[0], 3)).astype(np.uint8)
    path = tmp_path / f"picture.{suffix}"
    data = cv2.imencode(f".{suffix}", image)[1].tobytes()
    path.write_bytes(data)
    assert image_size(path) == size
    for cut in (0, 3, 9, 20, 27):
        path.write_bytes(data[:cut])
        with pytest.raises(BadInputError, match="not an image"):
            read_image(path)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(("kind", "value"), [(3, "H6x"), (4, "I4x"), (16, "Q")])
def test_a_bigtiff_tells_its_size_in_either_byte_order(order: str, kind: int, value: str) -> None:
    head = {"<": b"II", ">": b"MM"}[order] + struct.pack(f"{order}HHHQ", 43, 8, 0, 16)
    entries = (
        struct.pack(f"{order}HHQ{value}", tag, kind, 1, px) for tag, px in ((0x100, 640), (0x101, 480))
    )
    assert size_of(head + struct.pack(f"{order}Q", 2) + b"".join(entries)) == (640, 480)


@pytest.mark.parametrize(
    ("size", "why"),
    [((65000, 1), "too small or too narrow"), ((30000, 30000), r"decoded it takes 2\.7 GB of memory")],
)
def test_odd_sizes_are_refused_before_a_pixel_is_decoded(
    tmp_path: Path, size: tuple[int, int], why: str
) -> None:
    path = tmp_path / "odd.png"
    path.write_bytes(empty_png(*size))
    with limited_memory(3 << 30), pytest.raises(BadInputError, match=why):
        read_image(path)


def test_a_session_is_made_smaller_as_a_whole_to_fit_the_budget(boards: Session) -> None:
    whole = Dataset.open(boards.folder)
    with limited_memory(128 << 20) as budget:
        small = Dataset.open(boards.folder)
        assert small.image("left", 0).shape == (240, 320, 3)
        small = small.fitted(images=3, bytes_per_pixel=550)
    assert "work on 3 pictures of boards (320x240 pixels) is done at 50 %" in budget.notes[0]
    assert small.size("left") == (160, 120)
    assert small.image("left", 0).shape == (120, 160, 3)
    calibration = boards.calibration()
    assert calibration is not None
    view = calibrated_views(small, calibration)["left"]
    full = calibrated_views(whole, calibration)["left"]
    corner = np.array([[159.5, 119.5]])
    assert np.allclose(view.rays((corner + 0.5) / 2 - 0.5), full.rays(corner))
    truth, true = small.ground_truth("left", 0), whole.ground_truth("left", 0)
    assert truth is not None
    assert true is not None
    assert np.median(np.abs(truth[0] - true[0][::2, ::2])) < 0.01
    assert truth[1].mean() == pytest.approx(true[1].mean(), rel=0.05)
    assert small.fingerprint(None) != whole.fingerprint(None)


def test_a_file_of_another_size_than_the_session_says_is_refused_undecoded(
    boards: Session, tmp_path: Path
) -> None:
    dataset = Dataset(boards)
    record = next(one for one in boards.manifest.images if (one.camera, one.instant) == ("left", 0))
    path = boards.image_file(record)
    kept = path.read_bytes()
    try:
        path.write_bytes(empty_png(30000, 30000))
        with pytest.raises(BadInputError, match="is 30000x30000, but left is 320x240"):
            dataset.image("left", 0)
    finally:
        path.write_bytes(kept)


def test_the_longest_unused_array_is_dropped_first() -> None:
    made: list[object] = []

    def make(name: object) -> np.ndarray:
        made.append(name)
        return np.zeros(100, np.uint8)

    cache = ByteCache(make, 250)
    for name in ("a", "b", "a", "c", "a", "b"):
        assert cache(name).nbytes == 100
    assert made == ["a", "b", "c", "b"]
