"""A session of two strong lenses that see dots of known points, and how far a tool has them off."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from capture_app.session.format.calibration import Calibration, CameraCalibration
from capture_app.session.format.manifest import BurstRecord, CameraRecord
from capture_app.session.reading.reader import Session
from capture_app.session.writing.session_writer import SessionWriter
from tests.facts import make_facts

Array = np.ndarray[Any, Any]

WIDTH, HEIGHT = 480, 320
PERIOD_NS = 33_366_701
POINTS = np.array(
    [(0.0, 0.0, 0.0), (0.24, 0.13, 0.05), (-0.22, 0.12, -0.04), (-0.2, -0.14, 0.1), (0.2, -0.12, 0)]
)
"""In the rig's coordinates, in metres."""
CAMERAS = ("cam9", "cam10")
DOT = 0.014
"""A dot's standard deviation, in rays (x/z)."""
BACKGROUND, BRIGHT = 40, 190

Project = Callable[[Array], Array]
"""A point (3,) to its pixel (2,); the first pixel's centre is (0, 0)."""
Rays = Callable[[Array], Array]
"""Pixels (n, 2) to rays (n, 2), x/z and y/z in the camera."""


def lens(name: str) -> CameraCalibration:
    """A lens with a k3 that counts, half a metre from the rig's origin and turned in all axes."""
    side = -1.0 if name == "cam9" else 1.0
    rotation = cv2.Rodrigues(np.array([0.1, 0.3 * side, 0.04 * side]))[0]
    rows = [(float(x), float(y), float(z)) for x, y, z in rotation]
    return CameraCalibration(
        width=WIDTH,
        height=HEIGHT,
        fx=330.0,
        fy=331.5,
        cx=244.0 + 3 * side,
        cy=155.5,
        rotation=(rows[0], rows[1], rows[2]),
        translation=(0.01 * side, -0.02, 0.55),
        distortion=(-0.28, 0.11, 0.002 * side, -0.001, -0.05)
        if side > 0
        else (0.1, -0.2, 0.001, 0.002, 0.12),
    )


def opencv_pixel(camera: CameraCalibration, point: Array) -> Array:
    """Where OpenCV's model of the session's calibration has a point."""
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    turn = cv2.Rodrigues(np.array(camera.rotation))[0]
    seen = cv2.projectPoints(
        point.reshape(1, 1, 3), turn, np.array(camera.translation), matrix, np.array(camera.distortion)
    )[0]
    return np.asarray(seen).reshape(2)


def undistorted(pixels: Array, matrix: Array, distortion: Array) -> Array:
    """OpenCV's rays of pixels, by its fixed-point iteration, and so that they come back to the pixels."""
    until = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-12)
    rays = cv2.undistortPoints(pixels.reshape(-1, 1, 2).astype(float), matrix, distortion, criteria=until)
    return np.asarray(rays).reshape(-1, 2)


def dots(rays: Array, centres: Array) -> Array:
    """The light on each ray, of Gaussian dots around the centres."""
    away = ((rays[:, None] - centres[None]) ** 2).sum(axis=2)
    return np.asarray(BACKGROUND + BRIGHT * np.exp(-away / (2 * DOT**2)).sum(axis=1))


def picture(name: str) -> Array:
    """What the camera sees: grey, with a dot for each point, drawn in the rays of the lens."""
    camera = lens(name)
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    rays = undistorted(np.stack([columns.ravel(), rows.ravel()], axis=1), matrix, np.array(camera.distortion))
    local = POINTS @ np.array(camera.rotation).T + np.array(camera.translation)
    light = dots(rays, local[:, :2] / local[:, 2:]).reshape(HEIGHT, WIDTH)
    # Dithered, each channel by itself: their mean tells a dot's place to a few thousandths of a pixel.
    return np.floor(light[..., None] + np.random.default_rng(0).random((*light.shape, 3))).astype(np.uint8)


def build(folder: Path) -> Session:
    """Write the session: two instants of two cameras, as PNG."""
    writer = SessionWriter.create(folder, "dots")
    for instant in range(2):
        for name in CAMERAS:
            data = cv2.imencode(".png", picture(name))[1].tobytes()
            leader_ns = 10**9 + instant * PERIOD_NS
            writer.add_image(data, camera=name, instant=instant, leader_ns=leader_ns, suffix=".png")
    writer.set_calibration(Calibration(cameras={name: lens(name) for name in CAMERAS}))
    facts = make_facts(width=WIDTH, height=HEIGHT, period_ns=PERIOD_NS)
    records = [CameraRecord(name=name, facts=facts) for name in CAMERAS]
    burst = BurstRecord(instants_ns=(10**9, 10**9 + PERIOD_NS), period_ns=PERIOD_NS)
    return writer.finish(records, burst, [], origin="simulated")


def farthest_off(shown: Array, project: Project, rays: Rays) -> float:
    """The largest distance, px, between the dots of a picture and where a tool's arithmetic has the points.

    Each dot is drawn again by the tool's own numbers, and what is left over is solved for a shift.
    """
    grey = shown.mean(axis=2)
    worst = 0.0
    for point in POINTS:
        pixel = project(point)
        centre = rays(pixel[None])
        beside = np.linalg.norm(rays(pixel[None] + [[4.0, 0.0]]) - centre) / 4
        reach = 2.5 * DOT / beside
        across = np.arange(int(pixel[0] - reach), int(pixel[0] + reach) + 1)
        down = np.arange(int(pixel[1] - reach), int(pixel[1] + reach) + 1)
        columns, rows = np.meshgrid(across, down)
        model = dots(rays(np.stack([columns.ravel(), rows.ravel()], axis=1)), centre).reshape(rows.shape)
        slope_y, slope_x = np.gradient(model)
        parts = np.stack([slope_x, slope_y, model, np.ones_like(model)], axis=-1).reshape(-1, 4)
        left = (model - grey[down[0] : down[-1] + 1, across[0] : across[-1] + 1]).ravel()
        shift = np.linalg.lstsq(parts, left)[0]
        assert np.abs(left).mean() < 12, "there is no dot"
        worst = max(worst, float(np.hypot(shift[0], shift[1])))
    return worst
