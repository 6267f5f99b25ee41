"""Takes on disk for tests of the screen: each picture has a colour of its own."""

import hashlib
from pathlib import Path

import cv2
import numpy as np

from capture_app.session.format.manifest import BurstRecord, CameraRecord, ImageRecord, image_path
from capture_app.session.reading.reader import Session
from capture_app.session.writing.image_store import StoredImage
from capture_app.session.writing.session_writer import SessionWriter
from tests.facts import make_facts

WIDTH, HEIGHT = 64, 48
PERIOD_NS = 33_333_333


def picture_of(number: int) -> bytes:
    """A JPEG of one hue with a lighter middle, along the blocks that JPEG has: without any noise."""
    hsv = np.full((HEIGHT, WIDTH, 3), (number * 37 % 180, 200, 150), np.uint8)
    hsv[16:32, 16:48, 2] = 250
    options = [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
    return bytes(cv2.imencode(".jpg", cv2.cvtColor(hsv, cv2.COLOR_HSV2BGR), options)[1].tobytes())


def make_take(
    folder: Path,
    *,
    cameras: int = 3,
    instants: int = 3,
    name: str = "take",
    note: str = "",
    spread_ns: int = 40_000,
    uncertainty_ns: int | None = 9_000,
    created: str = "",
) -> Session:
    """A whole session of that many cameras and instants, its first and last camera so far apart."""
    writer = SessionWriter.create(folder, name, created=created)
    records = [
        CameraRecord(
            name=f"cam{number:02d}", facts=make_facts(width=WIDTH, height=HEIGHT, period_ns=PERIOD_NS)
        )
        for number in range(cameras)
    ]
    images = []
    for instant in range(instants):
        for number, camera in enumerate(records):
            residual_ns = spread_ns * number // max(1, cameras - 1) - spread_ns // 2
            picture = picture_of(number * instants + instant)
            record = ImageRecord(
                camera=camera.name,
                instant=instant,
                path=image_path(camera.name, instant),
                leader_ns=10**9 + instant * PERIOD_NS + residual_ns,
                residual_ns=residual_ns,
                uncertainty_ns=uncertainty_ns,
                hard_bound_ns=None if uncertainty_ns is None else 61_000,
                bytes=len(picture),
                sha256=hashlib.sha256(picture).hexdigest(),
            )
            images.append(StoredImage(record, picture))
    writer.save(images)
    burst = BurstRecord(
        instants_ns=tuple(10**9 + instant * PERIOD_NS for instant in range(instants)), period_ns=PERIOD_NS
    )
    return writer.finish(records, burst, (), "captured", note=note)
