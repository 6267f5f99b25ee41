"""A small session to read, break and verify."""

import json
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from capture_app.common.clock import SimulatedClock
from capture_app.session.format.calibration import Calibration, CameraCalibration
from capture_app.session.format.manifest import MANIFEST, BurstRecord, CameraRecord, ClockRecord, MissingImage
from capture_app.session.reading.reader import Session
from capture_app.session.writing.session_writer import SessionWriter
from tests.facts import make_facts
from tests.written_once import written_once

WIDTH, HEIGHT = 16, 12
INSTANTS = (1_000_000_000, 1_033_000_000, 1_066_000_000)
CLOCK = ClockRecord(
    epoch_local_ns=500_000_000,
    offset_ns=-7_200_000_000_123,
    skew_ppm=23.5,
    uncertainty_ns=30_000,
    hard_bound_ns=250_000,
    round_trip_ns=500_000,
    samples=300,
)


def jpeg(seed: int, width: int = WIDTH, height: int = HEIGHT, suffix: str = ".jpg") -> bytes:
    """A small picture of noise."""
    pixels = np.random.default_rng(seed).integers(0, 255, (height, width, 3), np.uint8)
    return bytes(cv2.imencode(suffix, pixels)[1].tobytes())


def camera_record(name: str, **facts: Any) -> CameraRecord:
    """A camera with a clock far from the leader's."""
    known = make_facts(**{"width": WIDTH, "height": HEIGHT, "period_ns": 33_000_000} | facts)
    return CameraRecord(name=name, facts=known, clock=CLOCK)


def local_from_leader(leader_ns: int) -> int:
    """Inverse of the clock record above, to 1 ns."""
    since_epoch = leader_ns - CLOCK.offset_ns - CLOCK.epoch_local_ns
    skew = CLOCK.skew_ppm * 1e-6
    return CLOCK.epoch_local_ns + round(since_epoch - since_epoch * skew / (1 + skew))


def calibration_of(name: str) -> Calibration:
    """A calibration of one camera, which stands upright beside the rig's origin."""
    upright = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    camera = CameraCalibration(
        width=WIDTH,
        height=HEIGHT,
        fx=21.0,
        fy=22.0,
        cx=3.0,
        cy=4.0,
        rotation=upright,
        translation=(0.1, 0.2, 0.3),
    )
    return Calibration(cameras={name: camera}, source="board")


def fill(writer: SessionWriter) -> Session:
    """Two cameras, three instants, one image missing, ground truth of one."""
    for number, instant_ns in enumerate(INSTANTS):
        for camera, residual_ns in (("left", 4_000), ("right", -9_000)):
            if (camera, number) == ("right", 2):
                continue
            leader_ns = instant_ns + residual_ns
            truth: dict[str, Any] = (
                {"truth": b"npz", "true_ns": 77} if (camera, number) == ("left", 0) else {}
            )
            writer.add_image(
                jpeg(number),
                camera=camera,
                instant=number,
                leader_ns=leader_ns,
                local_ns=local_from_leader(leader_ns),
                residual_ns=residual_ns,
                uncertainty_ns=20_000,
                hard_bound_ns=250_000,
                exposure_ns=100_000,
                gain=1.5,
                white_balance=(1.9, 1.4),
                sequence=number,
                **truth,
            )
    writer.add_event({"event": "aligned", "camera": "left", "phase_ns": 12})
    writer.images.clocks = {"left": SimulatedClock(5)}
    return writer.finish(
        [camera_record("left"), camera_record("right")],
        BurstRecord(instants_ns=INSTANTS, period_ns=33_000_000, requested_ns=INSTANTS[0] - 5),
        [MissingImage(camera="right", instant=2, reason="the node left")],
        origin="simulated",
    )


def edit_manifest(session: Session, change: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
    """Change the manifest by hand, and return it."""
    path = session.folder / MANIFEST
    content: dict[str, Any] = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))
    return content


@pytest.fixture
def session(tmp_path: Path) -> Session:
    """A complete small session."""
    return written_once("small", tmp_path / "small", lambda: fill(SessionWriter.create(tmp_path, "small")))


@pytest.fixture
def make_images(tmp_path: Path) -> Callable[..., Path]:
    """Make a folder of images with the names given."""

    def make(camera: str, names: list[str], width: int = WIDTH, height: int = HEIGHT) -> Path:
        folder = tmp_path / "recording" / camera
        folder.mkdir(parents=True)
        for seed, name in enumerate(names):
            (folder / name).write_bytes(jpeg(seed, width, height, Path(name).suffix))
        return folder

    return make


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Callable[[int], Path]]:
    """Mount a tmpfs of so many pages of 4 KiB; the next call makes it as large as asked."""
    folder = tmp_path / "disk"
    folder.mkdir()

    def mount(pages: int) -> Path:
        how = f"size={4 * pages}k"
        if folder.is_mount():
            how = f"remount,{how}"
        done = subprocess.run(
            ["mount", "-t", "tmpfs", "-o", how, "tmpfs", str(folder)],
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            pytest.skip(f"no small disk without the right to mount one: {done.stderr.strip()}")
        return folder

    yield mount
    if folder.is_mount():
        subprocess.run(["umount", "--lazy", str(folder)], check=True)
