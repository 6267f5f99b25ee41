"""A small calibrated session with everything that exports stumble over: gaps, a substitute, uneven times."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from capture_app.companions.exporting.export_session import export_session
from capture_app.session.exporting.exported_burst import ExportedBurst
from capture_app.session.format.calibration import Calibration, CameraCalibration
from capture_app.session.format.manifest import BurstRecord, CameraRecord, MissingImage
from capture_app.session.reading.reader import Session
from capture_app.session.writing.session_writer import SessionWriter
from tests.facts import make_facts
from tests.written_once import written_once

WIDTH, HEIGHT = 96, 64
PERIOD_NS = 33_366_701
START_NS = 7_200_000_000_123
GRID = (0, 1, 2, 5)
POINT = np.array([0.05, -0.03, 0.1])
"""In the rig's coordinates, in metres: a bright spot that every camera sees."""
DISTORTIONS = {
    "left": (0.0, 0.0, 0.0, 0.0, 0.0),
    "mid": (-0.12, 0.03, 0.002, -0.001, 0.0),
    "right": (-0.15, 0.05, 0.001, 0.002, 0.01),
}
RESIDUALS_NS = {"left": 4_321, "mid": -8_765, "right": 123}


def grey(camera: str, instant: int) -> int:
    """The background's brightness tells camera and instant, even after a lossy video."""
    return 20 + 40 * instant + 12 * list(DISTORTIONS).index(camera)


def calibrated(name: str, width: int = WIDTH, height: int = HEIGHT) -> CameraCalibration:
    """A camera half a metre from the rig's origin, looking at it."""
    angle = np.radians({"left": -25.0, "mid": 4.0, "right": 25.0}[name])
    rotation = cv2.Rodrigues(np.array([0.1 * angle, angle, 0.05]))[0]
    rows = [(float(x), float(y), float(z)) for x, y, z in rotation]
    return CameraCalibration(
        width=width,
        height=height,
        fx=90.0 + 2 * len(name),
        fy=91.0,
        cx=46.25,
        cy=32.5,
        rotation=(rows[0], rows[1], rows[2]),
        translation=(0.01, -0.02, 0.5),
        distortion=DISTORTIONS[name],
    )


def spot(camera: CameraCalibration, point: np.ndarray[Any, Any] = POINT) -> tuple[float, float]:
    """Where OpenCV sees a point of the rig, in pixels; the first pixel's centre is (0, 0)."""
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    rotation = cv2.Rodrigues(np.array(camera.rotation))[0]
    translation = np.array(camera.translation).reshape(3, 1)
    pixels = cv2.projectPoints(
        point.reshape(1, 1, 3), rotation, translation, matrix, np.array(camera.distortion)
    )[0]
    return float(pixels[0, 0, 0]), float(pixels[0, 0, 1])


def picture(camera: str, instant: int, width: int = WIDTH, height: int = HEIGHT) -> np.ndarray[Any, Any]:
    """A grey picture with a bright spot where the point is."""
    x, y = spot(calibrated(camera))
    rows, columns = np.mgrid[:height, :width]
    light = np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2 * 2.0**2))
    level = grey(camera, instant)
    image = level + (250 - level) * light
    return np.repeat(image.astype(np.uint8)[:, :, None], 3, axis=2)


def encode(pixels: np.ndarray[Any, Any], suffix: str = ".jpg") -> bytes:
    return bytes(cv2.imencode(suffix, pixels, [cv2.IMWRITE_JPEG_QUALITY, 98])[1].tobytes())


@dataclass
class Recipe:
    """What `make` builds; the defaults are the session that most tests use."""

    name: str = "clap"
    start_ns: int = START_NS
    suffixes: dict[str, str] = field(default_factory=dict)
    sizes: dict[str, tuple[int, int]] = field(default_factory=dict)
    calibrate: tuple[str, ...] = ("left", "mid", "right")
    unit: str = "m"
    missing: tuple[tuple[str, int], ...] = (("right", 1),)
    substitutes: dict[tuple[str, int], int] = field(default_factory=lambda: {("mid", 2): PERIOD_NS})
    """Images of another moment, and how much later than their instant, in ns."""


def build(folder: Path, recipe: Recipe) -> Session:
    """Write a session after a recipe."""
    writer = SessionWriter.create(folder, recipe.name)
    instants = tuple(recipe.start_ns + slot * PERIOD_NS for slot in GRID)
    sizes = {name: recipe.sizes.get(name, (WIDTH, HEIGHT)) for name in DISTORTIONS}
    for instant, instant_ns in enumerate(instants):
        for camera in DISTORTIONS:
            if (camera, instant) in recipe.missing:
                continue
            residual_ns = recipe.substitutes.get((camera, instant), RESIDUALS_NS[camera])
            suffix = recipe.suffixes.get(camera, ".jpg")
            writer.add_image(
                encode(picture(camera, instant, *sizes[camera]), suffix),
                camera=camera,
                instant=instant,
                leader_ns=instant_ns + residual_ns,
                suffix=suffix,
                residual_ns=residual_ns,
                uncertainty_ns=20_000,
                substitute=(camera, instant) in recipe.substitutes,
            )
    if recipe.calibrate:
        cameras = {name: calibrated(name, *sizes[name]) for name in recipe.calibrate}
        writer.set_calibration(Calibration(cameras=cameras, unit=recipe.unit))
    records = [
        CameraRecord(
            name=name, facts=make_facts(width=sizes[name][0], height=sizes[name][1], period_ns=PERIOD_NS)
        )
        for name in DISTORTIONS
    ]
    gone = [MissingImage(camera=name, instant=i, reason="the node left") for name, i in recipe.missing]
    burst = BurstRecord(instants_ns=instants, period_ns=PERIOD_NS)
    return writer.finish(records, burst, gone, origin="simulated")


Make = Callable[..., Session]
Export = Callable[..., ExportedBurst]


@pytest.fixture
def make(tmp_path: Path) -> Make:
    """Build a session; keyword arguments change the recipe."""

    def make(**changes: Any) -> Session:
        recipe, root = Recipe(**changes), tmp_path / "sessions"
        return written_once(repr(recipe), root / recipe.name, lambda: build(root, recipe))

    return make


@pytest.fixture
def export(tmp_path: Path) -> Export:
    """Export a session to tmp_path/out."""

    def run(session: Session, name: str, **options: Any) -> ExportedBurst:
        return export_session(session, name, tmp_path / "out", **options)

    return run
