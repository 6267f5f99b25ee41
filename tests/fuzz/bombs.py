"""Small files that ask a reader for far more time or memory than they have bytes, by the reader's name."""

import io
import pickle
import struct
import zipfile
import zlib
from collections.abc import Callable

import numpy as np

LAUGHS = 30
"""Levels of a list of two of the level before."""


def yaml_laughs(key: str = "a") -> bytes:
    """Anchors of anchors: each level holds the one before twice."""
    rows = ["x0: &x0 [1, 1]", *(f"x{n}: &x{n} [*x{n - 1}, *x{n - 1}]" for n in range(1, LAUGHS))]
    return "\n".join([*rows, f"{key}: *x{LAUGHS - 1}"]).encode()


def yaml_merges(key: str = "a") -> bytes:
    """Merge keys of merge keys."""
    rows = [
        "x0: &x0 {k: 1}",
        *(f"x{n}: &x{n} {{<<: [{', '.join([f'*x{n - 1}'] * 9)}]}}" for n in range(1, 9)),
    ]
    return "\n".join([*rows, f"{key}: *x8"]).encode()


def camchain_laughs() -> bytes:
    """Kalibr's file whose intrinsics are anchors of anchors."""
    camera = "cam0: {camera_model: pinhole, distortion_model: radtan, resolution: [2, 2], intrinsics: *x29}"
    return yaml_laughs() + f"\n{camera}\n".encode()


def ros_laughs() -> bytes:
    """ROS' file whose matrix is anchors of anchors."""
    return yaml_laughs() + b"\nimage_width: 2\ndistortion_model: plumb_bob\ncamera_matrix: {data: *x29}\n"


def opencv_laughs() -> bytes:
    """OpenCV's matrix whose numbers are anchors of anchors."""
    return b"%YAML:1.0\n" + yaml_laughs() + b"\nM: !!opencv-matrix {rows: 3, cols: 3, dt: d, data: *x29}\n"


def pickle_laughs(as_key: bool) -> bytes:
    """Tuples of tuples, as a matrix or as a key, whose hash visits each of them."""
    value = b"K\x01\x85" + b"".join(b"q%c0h%ch%c\x86" % (n, n, n) for n in range(40))
    return b"\x80\x03}" + (value + b"K\x01s." if as_key else b"X\x0c\x00\x00\x00intrinsicMat" + value + b"s.")


def hex_of_hex() -> bytes:
    """A text that a codec doubles forty times."""
    body = b"C\x01a"
    for _ in range(40):
        body = b"c_codecs\nencode\n" + body + b"X\x03\x00\x00\x00hex\x86R"
    return b"\x80\x03" + body + b"."


def numpy_call(name: str, arguments: bytes) -> bytes:
    """A pickle that calls one of numpy's names."""
    return b"\x80\x03}X\x0c\x00\x00\x00intrinsicMatcnumpy\n" + name.encode() + b"\n" + arguments + b"Rs."


def mat(variables: int, size: int) -> bytes:
    """A MAT-file whose variables are zeros."""
    flags = struct.pack("<IIII", 6, 8, 9, 0)
    shape = struct.pack("<IIii", 5, 8, 1, size)
    name = struct.pack("<II8s", 1, 2, b"kk")
    packed = zlib.compress(
        struct.pack("<II", 14, 16 + 16 + 16 + 8 + size)
        + flags
        + shape
        + name
        + struct.pack("<II", 2, size)
        + bytes(size),
        9,
    )
    return (
        b"MATLAB 5.0".ljust(124) + b"\x00\x01IM" + (struct.pack("<II", 15, len(packed)) + packed) * variables
    )


def npz(size: int, header: str | None = None) -> bytes:
    """A .npz of zeros, or of a header that claims more than follows."""
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w", zipfile.ZIP_DEFLATED) as archive:
        member = io.BytesIO()
        np.save(member, np.zeros(size, np.int8))
        content = member.getvalue()
        if header is not None:
            text = header.ljust(117).encode() + b"\n"
            content = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + bytes(100)
        archive.writestr("mtx.npy", content)
    return data.getvalue()


def png(width: int, height: int, *, with_pixels: bool) -> bytes:
    """A black PNG of any size, in a thousandth of its pixels' bytes; or its header only."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    packer = zlib.compressobj(9)
    rows = bytes((1 + 3 * width) * 64)
    pixels = (
        b"".join(packer.compress(rows) for _ in range(height // 64)) + packer.flush() if with_pixels else b""
    )
    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", pixels) + chunk(b"IEND", b"")


def xml_laughs() -> bytes:
    """Entities of entities."""
    entities = "".join(f'<!ENTITY x{n} "{f"&x{n - 1};" * 10}">' for n in range(1, 10))
    return f'<!DOCTYPE document [<!ENTITY x0 "ha">{entities}]><document>&x9;</document>'.encode()


def sound_rate(rate_hz: int) -> bytes:
    """A WAVE file of a tenth of a second that states a rate."""
    form = struct.pack("<IHHIIHH", 16, 1, 1, rate_hz, 32_000, 2, 16)
    return b"RIFF\xa4\x0c\x00\x00WAVEfmt " + form + b"data\x80\x0c\x00\x00" + b"\x10\x20" * 1600


BOMBS: dict[str, dict[str, Callable[[], bytes]]] = {
    "sound": {"rate": lambda: sound_rate(200_000_033)},
    "calibration-kalibr": {
        "laughs": camchain_laughs,
        "merges": yaml_merges,
        "itself": lambda: b"a: &a [*a, *a]",
        "large": lambda: b"a: [" + b"1, " * 49_000 + b"1]",
        "maps": lambda: b"a: [" + b"{}," * 49_000 + b"1]",
        "sixties": lambda: b"a: " + b"1:" * 74_000 + b"1",
        "deep": lambda: b"[" * 149_000,
    },
    "calibration-ros": {"laughs": ros_laughs, "merges": yaml_merges},
    "calibration-opencv": {
        "laughs": opencv_laughs,
        "type": lambda: opencv_laughs().replace(b"dt: d", b"dt: *x29"),
    },
    "calibration-kitti": {
        "lines": lambda: b"".join(b"k%d: 1\n" % n for n in range(1_000_000)),
        "numbers": lambda: b"P0: " + b"1 " * 8_000_000,
    },
    "calibration-handpose3d": {"spaces": lambda: b"R:" + b" " * 16_000 + b"x"},
    "calibration-llff": {
        "shape": lambda: (
            b"\x93NUMPY\x01\x00\x76\x00"
            + b"{'descr': '<f8', 'fortran_order': False, 'shape': (99999999999,), }".ljust(117)
            + b"\n"
        ),
    },
    "calibration-easymocap": {
        "laughs": lambda: b"%YAML:1.0\n---\n" + yaml_laughs("names"),
        "many": lambda: b"%YAML:1.0\n---\nnames: [" + b"1, " * 20_000 + b"1]",
    },
    "calibration-pickle": {
        "memo": lambda: b"\x80\x03Nr\xff\xff\xff\x7f.",
        "tuples": lambda: pickle_laughs(as_key=False),
        "keys": lambda: pickle_laughs(as_key=True),
        "doubled": lambda: b"\x80\x03}K\x01" + b"2\x86" * 60 + b"K\x01s.",
        "hex": hex_of_hex,
        "empty": lambda: numpy_call("ndarray", b"J\xff\xff\xff\x0fX\x01\x00\x00\x00O\x86"),
        "strides": lambda: numpy_call(
            "ndarray", b"(J\xff\xff\xff\x0fX\x02\x00\x00\x00f4C\x04\x00\x00\x00\x00K\x00K\x00\x85t"
        ),
        "bytearray": lambda: b"\x80\x05\x96" + struct.pack("<Q", 1 << 32) + b".",
        "plain": lambda: pickle.dumps({"intrinsicMat": [[0] * 1000] * 1000}),
    },
    "calibration-toml": {
        "dots": lambda: b"a" + b".a" * 20_000 + b" = 1",
        "table": lambda: b"[a" + b".a" * 20_000 + b"]",
        "quoted": lambda: b'","' + b' . ","' * 20_000 + b" = 1",
        "many": lambda: b"".join(b"a%d" % n + b".a" * 250 + b" = 1\n" for n in range(500)),
        "inline": lambda: b"a = " + b"{a=" * 60_000,
        "lists": lambda: b"a = " + b"[" * 200_000,
    },
    "calibration-matlab": {
        "one": lambda: mat(1, 1 << 26),
        "many": lambda: mat(30, 60_000_000),
        "small": lambda: mat(10_000, 65_000),
    },
    "calibration-npz": {
        "zeros": lambda: npz(1 << 30),
        "claims": lambda: npz(0, "{'descr': '<f8', 'fortran_order': False, 'shape': (4294967296,), }"),
        "nothing": lambda: npz(0, "{'descr': '|V0', 'fortran_order': False, 'shape': (4294967296,), }"),
    },
    "calibration-metashape": {
        "laughs": xml_laughs,
        "elements": lambda: b"<document>" + b"<a/>" * 520_000 + b"</document>",
        "attributes": lambda: b"<document>" + b"<a b=''/>" * 230_000 + b"</document>",
        "large": lambda: b"<document>" + b"<a/>" * 1_000_000 + b"</document>",
        "deep": lambda: b"<document>" + b"<a>" * 690_000,
    },
    "calibration-opensfm": {
        "lists": lambda: b"[" + b"[]," * 499_000 + b"[]]",
        "more lists": lambda: b"[" + b"[]," * 5_000_000 + b"[]]",
        "deep": lambda: b"[" * 5_000_000,
        "wide": lambda: b'{"w": ["' + b"a" * 8_000_000 + b'"' + b',""' * 1_000_000 + b"]}",
    },
    "calibration-colmap": {"counts": lambda: struct.pack("<Q", 1 << 62) + bytes(100)},
    "picture": {
        "header": lambda: png(65_535, 65_535, with_pixels=False),
        "black": lambda: png(16_384, 16_384, with_pixels=True),
    },
    "import-picture": {
        "black": lambda: png(16_384, 16_384, with_pixels=True),
        "allowed": lambda: png(5_760, 5_760, with_pixels=True),
    },
}
"""The bytes of each, by its name."""
