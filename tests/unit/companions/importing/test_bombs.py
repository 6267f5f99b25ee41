"""Small files that claim to be huge, are nested too deeply or never end: a clear error, and little memory."""

import os
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import pytest
import zstandard

from capture_app.cli import run
from capture_app.common.errors import CameraError, ExitCode
from capture_app.plugins.cameras.rtsp.connection import AccessUnits
from capture_app.session.reading.decoding import MAX_SENT_PIXELS, decode_image, size_of
from tests.fuzz.bombs import BOMBS

MEASURED = """
import resource, sys
from capture_app.cli import main
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
try:
    main()
except SystemExit as end:
    code = end.code
print(code, (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) // 1024)
"""


def run_measured(*arguments: str) -> tuple[int, int, str]:
    """Run capture-app in a process; return its exit code, the memory it took (MB), and its talk."""
    found = subprocess.run(
        [sys.executable, "-c", MEASURED, *arguments], capture_output=True, text=True, timeout=60, check=False
    )
    assert "Traceback" not in found.stderr, found.stderr
    code, megabytes = found.stdout.split()[-2:]
    return int(code), int(megabytes), found.stderr


def png(width: int, height: int) -> bytes:
    """A PNG of zeros, which compresses a thousandfold."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    packer, rows = zlib.compressobj(1), bytes(width // 8 + 1)
    data = b"".join(packer.compress(rows) for _ in range(height)) + packer.flush()
    head = struct.pack(">IIBBBBB", width, height, 1, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def test_a_preview_of_a_huge_size_is_not_decoded() -> None:
    bomb = png(16384, 16384)
    assert len(bomb) < 3_000_000
    assert decode_image(bomb, colour=True, max_pixels=MAX_SENT_PIXELS) is None


def test_a_chunk_that_claims_more_than_the_image_needs_is_not_decoded() -> None:
    """OpenCV takes the memory that it claims: 3.2 GB for a PNG of a kilobyte."""
    small = png(64, 64)
    at = small.index(b"IDAT") - 4
    for length in (0x7FC00000, 2**31, 2**32 - 1):
        assert decode_image(small[:at] + struct.pack(">I", length) + small[at + 4 :]) is None
    assert decode_image(small) is not None
    assert size_of(small[:-30]) == (64, 64), "cut off, but of this size"


def test_an_image_whose_size_cannot_be_read_first_is_not_decoded() -> None:
    assert decode_image(b"P5 30000 30000 255\n" + bytes(100)) is None


def test_a_blank_image_is_not_decoded_if_it_is_far_larger_than_its_file() -> None:
    assert decode_image(png(8192, 8192)) is None
    assert decode_image(png(8192, 8192).ljust(2_000_000)) is not None, "as large as a photograph"


def test_packets_without_an_end_of_the_picture_are_refused() -> None:
    units = AccessUnits("h264", 96)
    packet = struct.pack(">BBHII", 0x80, 96, 0, 7, 1) + b"\x65" + bytes(1 << 20)
    for _ in range(7):
        units.add(packet, 0)
    with pytest.raises(CameraError, match="8 MiB"):
        units.add(packet, 0)


def mcap(path: Path, compression: bytes, data: bytes, claimed: int) -> Path:
    """An .mcap of one chunk."""
    chunk = struct.pack("<QQQII", 0, 0, claimed, 0, len(compression)) + compression
    chunk += struct.pack("<Q", len(data)) + data
    header = struct.pack("<I", 0) + struct.pack("<I", 0)
    records = b"".join(struct.pack("<BQ", kind, len(of)) + of for kind, of in ((1, header), (6, chunk)))
    path.write_bytes(b"\x89MCAP0\r\n" + records + struct.pack("<BQ", 2, 20) + bytes(20) + b"\x89MCAP0\r\n")
    return path


@pytest.fixture(scope="module")
def zeros() -> bytes:
    """256 MiB of zeros, compressed."""
    return zstandard.compress(bytes(1 << 28))


@pytest.mark.parametrize("claimed", [1 << 28, 100])
def test_a_chunk_that_unpacks_to_256_mb_is_refused(tmp_path: Path, zeros: bytes, claimed: int) -> None:
    bomb = mcap(tmp_path / "bomb.mcap", b"zstd", zeros, claimed)
    code, megabytes, talk = run_measured(
        "sessions", "import", str(bomb), "--name", "x", "--out", str(tmp_path / "out")
    )
    assert (code, megabytes < 200) == (3, True), (code, megabytes, talk)
    assert "chunk" in talk


@pytest.mark.parametrize("name", ["x.mcap", "x.mp4", "x.bag"])
def test_a_pipe_is_refused_and_not_waited_for(tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / name)
    call = ["sessions", "import", str(tmp_path / name), "--name", "x", "--out", str(tmp_path / "out")]
    assert run(call) == ExitCode.BAD_INPUT


ENDLESS = {
    "times.csv": "camera,frame,time_s\n" + "a" * 200_000 + ",0,0\n",
    "lenses.toml": "[cameras]\nx = " + "[" * 100_000,
    "lenses.json": "[" * 100_000,
    "lenses.yml": "%YAML:1.0\n---\n" + "a: [" * 100_000,
    "itself.yml": "%YAML:1.0\n---\na: &a [*a]",
    **{
        name: BOMBS[reader][bomb]().decode("latin-1")
        for name, reader, bomb in (
            ("camchain.yaml", "calibration-kalibr", "laughs"),
            ("left.yaml", "calibration-ros", "merges"),
            ("dots.toml", "calibration-toml", "dots"),
            ("memo.pickle", "calibration-pickle", "memo"),
            ("keys.pickle", "calibration-pickle", "keys"),
            ("hex.pickle", "calibration-pickle", "hex"),
            ("lists.json", "calibration-opensfm", "more lists"),
            ("large.xml", "calibration-metashape", "large"),
        )
    },
}


@pytest.mark.parametrize("name", ENDLESS)
def test_a_deep_or_long_file_of_times_or_lenses_is_refused(tmp_path: Path, name: str) -> None:
    for camera in ("a", "b"):
        (tmp_path / "in" / camera).mkdir(parents=True)
        for number in range(3):
            (tmp_path / "in" / camera / f"{number}.png").write_bytes(png(64, 48))
    (tmp_path / name).write_text(ENDLESS[name], "latin-1")
    option = "--timestamps" if name.endswith(".csv") else "--calibration"
    call = ["sessions", "import", str(tmp_path / "in"), "--name", "x", "--out", str(tmp_path / "out")]
    assert run([*call, "--fps", "30", option, str(tmp_path / name)]) == ExitCode.BAD_INPUT
