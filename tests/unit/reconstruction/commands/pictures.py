"""Broken and odd pictures and manifests, each by what it does to a sound session."""

import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from reconstruction.common.geometry import Array
from tests.unit.reconstruction.commands.calibrations import Change, both
from tests.unit.reconstruction.commands.odd_session import INSTANTS, OddSession

NAMES = ("left", "middle", "right")
RNG = np.random.default_rng(8)


def png_of_zeros(width: int, height: int, *, cut: bool = False) -> bytes:
    """A black PNG of any size, made row by row; `cut`: its header alone."""

    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    if cut:
        return header
    packer, row = zlib.compressobj(1), bytes(1 + 3 * width)
    packed = b"".join(packer.compress(row) for _ in range(height)) + packer.flush()
    return header + chunk(b"IDAT", packed) + chunk(b"IEND", b"")


def jpeg_header(width: int, height: int) -> bytes:
    """A JPEG that ends after its frame header."""
    frame = struct.pack(">BHHB", 8, height, width, 3) + b"\x01\x11\0\x02\x11\0\x03\x11\0"
    return b"\xff\xd8\xff\xc0" + struct.pack(">H", 2 + len(frame)) + frame


def _bytes(
    data: Callable[[bytes], bytes], camera: str | None = None, size: tuple[int, int] | None = None
) -> Change:
    """Change the files; `size`: what the manifest says of it."""

    def change(session: OddSession) -> None:
        for record in session.records(camera):
            session.put_bytes(record, data((session.folder / record["path"]).read_bytes()))
            if size is not None:
                facts = session.facts(record["camera"])
                facts["width"], facts["height"] = size

    return change


def _pixels(how: Callable[[Array], Array], camera: str | None = None, *, calibrated: bool = True) -> Change:
    """Change the pictures."""

    def change(session: OddSession) -> None:
        session.change(how, camera)
        if not calibrated:
            session.calibration = None

    return change


def _drop(lacks: Callable[[str, int], bool], *, calibrated: bool = True) -> Change:
    """Leave images out."""

    def change(session: OddSession) -> None:
        session.drop(lacks)
        if not calibrated:
            session.calibration = None

    return change


def _data(how: Callable[[dict[str, Any]], Any]) -> Change:
    """Change the manifest."""

    def change(session: OddSession) -> None:
        how(session.manifest)

    return change


def _images(field: str, value: Any, camera: str | None = None) -> Change:
    """Give a field of image records another value."""

    def change(session: OddSession) -> None:
        for record in session.records(camera):
            record[field] = value

    return change


def _facts(field: str, value: Any) -> Change:
    """Give a field of all cameras' facts another value."""

    def change(session: OddSession) -> None:
        for camera in session.manifest["cameras"]:
            camera["facts"][field] = value

    return change


def _no_calibration(session: OddSession) -> None:
    session.calibration = None


def _still(session: OddSession) -> None:
    """Every instant shows the first."""
    first = {r["camera"]: session.picture(r) for r in session.records() if r["instant"] == 0}
    for record in session.records():
        session.put(record, first[record["camera"]])


def _instants(*times_ns: int) -> Change:
    """Give the burst other instants."""
    return _data(lambda manifest: manifest["burst"].update(instants_ns=list(times_ns)))


def _grow_on_disk(session: OddSession) -> None:
    file = _on_disk(session)
    file.write_bytes(file.read_bytes() + b"x")


def _on_disk(session: OddSession) -> Path:
    """The first image's file."""
    return session.folder / next(session.records())["path"]


def _one_camera(session: OddSession) -> None:
    session.drop(lambda camera, instant: camera != "left")
    session.manifest["cameras"] = session.manifest["cameras"][:1]


def _one_picture_for_all(session: OddSession) -> None:
    image = session.picture(next(session.records()))
    for record in session.records():
        session.put(record, image)


def _swapped(session: OddSession) -> None:
    """Two cameras' pictures are each other's."""
    pictures = {(r["camera"], r["instant"]): session.picture(r) for r in session.records()}
    swap = {"left": "right", "right": "left", "middle": "middle"}
    for record in session.records():
        session.put(record, pictures[swap[record["camera"]], record["instant"]])


def _flat(level: int) -> Callable[[Array], Array]:
    return lambda image: np.full_like(image, level)


def _noise(image: Array) -> Array:
    return RNG.integers(0, 256, image.shape).astype(np.uint8)


def _resized(width: int, height: int) -> Callable[[Array], Array]:
    return lambda image: cv2.resize(image, (width, height))


def _shaken(session: OddSession) -> None:
    """Every picture is moved by some pixels, as of a rig that moves."""
    for k, record in enumerate(session.records()):
        session.put(record, np.roll(session.picture(record), (5 * k % 23, 7 * k % 29), (0, 1)))


def _exif_turned(data: bytes) -> bytes:
    """The picture as a JPEG whose EXIF says that it is to be turned by 90 degrees."""
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
    jpeg = cv2.imencode(".jpg", image)[1].tobytes()
    exif = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"
    return jpeg[:2] + b"\xff\xe1" + struct.pack(">H", 2 + len(exif)) + exif + jpeg[2:]


STRIPES = np.tile(np.repeat(np.array([40, 210], np.uint8), 8), (240, 20))

PICTURES: dict[str, Change] = {
    "65000x1": _bytes(lambda _: png_of_zeros(65000, 1), size=(65000, 1)),
    "65000x1, one": _bytes(lambda _: png_of_zeros(65000, 1), "left", (65000, 1)),
    "1x65000, one": _bytes(lambda _: png_of_zeros(1, 65000), "middle", (1, 65000)),
    "65000x1, unsaid": _bytes(lambda _: png_of_zeros(65000, 1), "left"),
    "30000x30000": _bytes(lambda _: png_of_zeros(30000, 30000, cut=True), size=(30000, 30000)),
    "30000x30000, one": _bytes(lambda _: png_of_zeros(30000, 30000, cut=True), "right", (30000, 30000)),
    "30000x30000, unsaid": _bytes(lambda _: png_of_zeros(30000, 30000, cut=True)),
    "30000x30000 JPEG, one": _bytes(lambda _: jpeg_header(30000, 30000), "left", (30000, 30000)),
    "12000x9000, one": _bytes(lambda _: png_of_zeros(12000, 9000), "left", (12000, 9000)),
    "2147483647x2147483647": _bytes(lambda _: png_of_zeros(2**31 - 1, 2**31 - 1, cut=True)),
    "said to be 30000x30000": both(_facts("width", 30000), _facts("height", 30000)),
    "said to be 2e9 wide": _facts("width", 2_000_000_000),
    "said to be 0 wide": _facts("width", 0),
    "said to be -1 high": _facts("height", -1),
    "1x1": _pixels(_resized(1, 1)),
    "15x11": _pixels(_resized(15, 11)),
    "16x16": _pixels(_resized(16, 16)),
    "24x18": _pixels(_resized(24, 18)),
    "40x30": _pixels(_resized(40, 30)),
    "320x16": _pixels(_resized(320, 16)),
    "640x17, one": _pixels(_resized(640, 17), "right"),
    "sizes differ": _pixels(_resized(160, 120), "right"),
    "sizes differ by 1": _pixels(_resized(319, 239), "left"),
    "shape of one turned": _pixels(lambda i: np.rot90(i), "left"),
    "black": _pixels(_flat(0)),
    "white": _pixels(_flat(255)),
    "grey": _pixels(_flat(128)),
    "black, uncalibrated": _pixels(_flat(0), calibrated=False),
    "one black": _pixels(_flat(0), "left"),
    "one white": _pixels(_flat(255), "middle"),
    "two black": both(_pixels(_flat(0), "left"), _pixels(_flat(0), "right")),
    "noise": _pixels(_noise),
    "noise, uncalibrated": _pixels(_noise, calibrated=False),
    "one noise": _pixels(_noise, "right"),
    "still": _still,
    "shaken": _shaken,
    "one picture for all": _one_picture_for_all,
    "one picture for all, uncalibrated": both(_one_picture_for_all, _no_calibration),
    "turned upside down": _pixels(lambda i: i[::-1, ::-1]),
    "turned upside down, one": _pixels(lambda i: i[::-1, ::-1], "middle"),
    "mirrored pictures": _pixels(lambda i: i[:, ::-1]),
    "mirrored pictures, one": _pixels(lambda i: i[:, ::-1], "left"),
    "mirrored, uncalibrated": _pixels(lambda i: i[:, ::-1], calibrated=False),
    "negative, one": _pixels(lambda i: 255 - i, "left"),
    "dark": _pixels(lambda i: i // 32),
    "two levels": _pixels(lambda i: np.where(i > 128, 255, 0).astype(np.uint8)),
    "stripes": _pixels(lambda i: STRIPES),
    "stripes across": _pixels(lambda i: np.ascontiguousarray(np.rot90(np.tile(STRIPES, (2, 1)))[:240, :320])),
    "half black": _pixels(lambda i: np.where(np.arange(320) < 160, 0, i).astype(np.uint8)),
    "blurred": _pixels(lambda i: cv2.GaussianBlur(i, (0, 0), 12)),
    "swapped cameras": _swapped,
    "swapped, uncalibrated": both(_swapped, _no_calibration),
    "16 bits": _pixels(lambda i: i.astype(np.uint16) * 257),
    "with alpha": _pixels(lambda i: cv2.merge([i, i, i, np.zeros_like(i)])),
    "turned by EXIF": _bytes(_exif_turned, "left"),
    "cut in the middle": _bytes(lambda data: data[: len(data) // 2]),
    "cut in the middle, one": _bytes(lambda data: data[: len(data) // 2], "right"),
    "cut after the header": _bytes(lambda data: data[:60], "left"),
    "bits flipped": _bytes(lambda data: data[:2000] + bytes(255 - b for b in data[2000:2400]) + data[2400:]),
    "no pictures but text": _bytes(lambda _: b"this is no picture"),
    "zeros": _bytes(lambda _: bytes(5000), "middle"),
    "a GIF": _bytes(lambda _: b"GIF89a\x40\x01\xf0\0\x80\0\0\0\0\0\xff\xff\xff,\0\0\0\0", "left"),
    "no images of one camera": _drop(lambda c, k: c == "left"),
    "no images of one camera, uncalibrated": _drop(lambda c, k: c == "left", calibrated=False),
    "no images of two cameras": _drop(lambda c, k: c != "right"),
    "no images of two cameras, uncalibrated": _drop(lambda c, k: c != "right", calibrated=False),
    "one image of one camera": _drop(lambda c, k: c == "middle" and k > 0),
    "one image of one camera, uncalibrated": _drop(lambda c, k: c == "middle" and k > 0, calibrated=False),
    "cameras in turns": _drop(lambda c, k: NAMES[k] == c),
    "cameras in turns, uncalibrated": _drop(lambda c, k: NAMES[k] == c, calibrated=False),
    "each camera once": _drop(lambda c, k: NAMES[k] != c),
    "each once, uncalibrated": _drop(lambda c, k: NAMES[k] != c, calibrated=False),
    "first instant empty": _drop(lambda c, k: k == 0),
    "only the first instant": _drop(lambda c, k: k > 0),
    "no images": _drop(lambda c, k: True),
    "one camera only": _one_camera,
    "uncalibrated": _no_calibration,
    "one is missing on disk": lambda s: _on_disk(s).unlink(),
    "one grew on disk": _grow_on_disk,
    "a folder for a picture": both(lambda s: _on_disk(s).unlink(), lambda s: _on_disk(s).mkdir()),
}  # fmt: skip

MANIFESTS: dict[str, Change] = {
    "one instant": both(_drop(lambda c, k: k > 0), _instants(0)),
    "no instants": both(_drop(lambda c, k: True), _instants()),
    "no cameras": _data(lambda m: m.update(cameras=[], images=[])),
    "instants all the same": _instants(*[0] * INSTANTS),
    "instants backwards": _instants(66_666_666, 33_333_333, 0),
    "instants years apart": _instants(0, 10**17, 2 * 10**17),
    "instants a ns apart": _instants(0, 1, 2),
    "instants beyond 64 bits": _instants(0, 2**80, 2**81),
    "period 0": _data(lambda m: m["burst"].update(period_ns=0)),
    "period a year": _data(lambda m: m["burst"].update(period_ns=3 * 10**16)),
    "period 1 ns": _data(lambda m: m["burst"].update(period_ns=1)),
    "a camera twice": _data(lambda m: m["cameras"].append(m["cameras"][0])),
    "an image twice": _data(lambda m: m["images"].append(m["images"][0])),
    "an image of no camera": _images("camera", "nobody", "left"),
    "an image of no instant": _images("instant", 77, "left"),
    "a path that leads out": _images("path", "../../../etc/passwd", "right"),
    "a checksum of zeros": _images("sha256", "0" * 64),
    "all substitutes": _images("substitute", True),
    "times that jump": _images("leader_ns", 10**18, "left"),
    "a newer schema": _data(lambda m: m.update(schema_version=99)),
    "an unknown field": _data(lambda m: m.update(colour="blue")),
    "a name that leads out": _data(lambda m: m.update(name="../odd")),
    "a camera's name that leads out": lambda s: s.manifest["cameras"][0].update(name="../left"),
}  # fmt: skip
