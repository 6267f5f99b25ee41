"""Rendered takes of the jumping child by two rolling shutters, one of which is later than its times say."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import msgspec

from capture_app.session.format.manifest import BurstRecord, CameraRecord
from capture_app.session.reading.reader import Session
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.simulation.rendering import scene
from tests.facts import make_facts

PERIOD_NS = 33_333_000
JPEG_QUALITY = 90


@dataclass(frozen=True)
class Shutter:
    """A camera's view of the scene, its rows, its exposure, and how much later it is than its times say."""

    view: str
    row_time_ns: int
    exposure_ns: int
    late_ns: int = 0
    told_row_time_ns: int | None = None
    """Where the session has another row time than the true one."""


@dataclass(frozen=True)
class Take:
    """What a session shows: from `start_ns` of the scene's motion, `frames` of each camera."""

    cameras: Mapping[str, Shutter]
    start_ns: int
    frames: int = 30
    name: str = "studio"
    scale: float = 1.0

    def at(self, late_ns: Mapping[str, int]) -> "Take":
        """The same with cameras that are so late."""
        moved = {name: replace(one, late_ns=late_ns.get(name, 0)) for name, one in self.cameras.items()}
        return replace(self, cameras=moved)


def write_take(root: Path, name: str, take: Take, *, calibrated: bool) -> Session:
    """Its session; without its calibration the geometry is what its pictures tell."""
    stage = scene.load(take.name, scale=take.scale)
    writer = SessionWriter.create(root, name)
    for camera, shutter in take.cameras.items():
        for k in range(take.frames):
            told_ns = k * PERIOD_NS
            true_ns = take.start_ns + told_ns + shutter.late_ns
            image = stage.render(
                shutter.view, true_ns, shutter.exposure_ns, _rows_ns(shutter, take), seed=k + 1000
            )
            writer.add_image(
                cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes(),
                camera=camera,
                instant=k,
                leader_ns=told_ns,
                exposure_start_ns=told_ns,
                exposure_ns=shutter.exposure_ns,
            )
    if calibrated:
        known = stage.calibration()
        cameras = {camera: known.cameras[shutter.view] for camera, shutter in take.cameras.items()}
        writer.set_calibration(msgspec.structs.replace(known, cameras=cameras))
    records = []
    for camera, shutter in take.cameras.items():
        view = stage.views[shutter.view]
        told = shutter.told_row_time_ns
        facts = make_facts(
            width=view.width,
            height=view.height,
            period_ns=PERIOD_NS,
            row_time_ns=_rows_ns(shutter, take) if told is None else told,
            exposure_ns=shutter.exposure_ns,
        )
        records.append(CameraRecord(name=camera, facts=facts))
    instants = tuple(k * PERIOD_NS for k in range(take.frames))
    burst = BurstRecord(instants_ns=instants, period_ns=PERIOD_NS)
    return writer.finish(records, burst, origin="simulated")


def _rows_ns(shutter: Shutter, take: Take) -> int:
    """So that smaller pictures take as long to read."""
    return round(shutter.row_time_ns / take.scale)
