"""Cameras in the order in which one walks past them."""

import math
import random
from pathlib import Path

import pytest

from capture_app.session.format.calibration import Calibration, CameraCalibration
from capture_app.session.reading.reader import Session
from capture_app.session.reading.take_sheet import arc_order
from capture_app.session.writing.session_writer import SessionWriter

from .conftest import HEIGHT, INSTANTS, WIDTH, BurstRecord, camera_record, jpeg


def pose_at(angle: float, radius: float = 3.0) -> CameraCalibration:
    """A camera on a circle around (1, 0, 5), 1.5 up (y is down), that looks at its axis."""
    centre = (1 + radius * math.sin(angle), -1.5, 5 - radius * math.cos(angle))
    x, z = (math.cos(angle), 0.0, math.sin(angle)), (-math.sin(angle), 0.0, math.cos(angle))
    rotation = (x, (0.0, 1.0, 0.0), z)
    moved = [-sum(r * c for r, c in zip(row, centre, strict=True)) for row in rotation]
    translation = (moved[0], moved[1], moved[2])
    return CameraCalibration(
        width=WIDTH,
        height=HEIGHT,
        fx=10.0,
        fy=10.0,
        cx=8.0,
        cy=6.0,
        rotation=rotation,
        translation=translation,
    )


def session_of(folder: Path, names: list[str], poses: dict[str, CameraCalibration]) -> Session:
    writer = SessionWriter.create(folder, "take")
    for name in names:
        writer.add_image(jpeg(1), camera=name, instant=0, leader_ns=INSTANTS[0])
    if poses:
        writer.set_calibration(Calibration(cameras=poses))
    burst = BurstRecord(instants_ns=INSTANTS[:1], period_ns=33_000_000)
    return writer.finish([camera_record(name) for name in names], burst, (), "captured")


@pytest.mark.parametrize(
    "degrees", [(-40, -10, 5, 30, 50), (-130, -60, 0, 60, 130), (120, 150, 179, 200, 230)]
)
def test_along_the_arc_where_poses_are_known(tmp_path: Path, degrees: tuple[int, ...]) -> None:
    names = ["e", "b", "d", "a", "c"]
    poses = {name: pose_at(math.radians(angle)) for name, angle in zip(names, degrees, strict=True)}
    shuffled = random.Random(4).sample(names, 5)
    found = arc_order(session_of(tmp_path, shuffled, poses))
    assert found == tuple(names)


def test_parallel_cameras_in_their_row(tmp_path: Path) -> None:
    poses = {}
    for name, x in {"a": 2.0, "b": -1.0, "c": 0.5, "d": 0.0}.items():
        ahead = pose_at(0.0)
        poses[name] = CameraCalibration(
            width=WIDTH,
            height=HEIGHT,
            fx=10,
            fy=10,
            cx=8,
            cy=6,
            rotation=ahead.rotation,
            translation=(-x, 0, 0),
        )
    assert arc_order(session_of(tmp_path, list(poses), poses)) == ("b", "d", "c", "a")


def test_by_name_where_not_all_poses_are_known(tmp_path: Path) -> None:
    names = ["cam10", "cam2", "cam1"]
    assert arc_order(session_of(tmp_path, names, {"cam2": pose_at(1.0)})) == ("cam1", "cam2", "cam10")
