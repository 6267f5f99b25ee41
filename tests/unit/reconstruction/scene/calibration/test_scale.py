"""A calibration without a board gets its scale, and lenses that cannot be are refused."""

import math
import shutil
import struct
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest

from capture_app.board.boards import DEFAULT_BOARD
from capture_app.common.errors import BadInputError
from capture_app.session.format.calibration import Calibration
from capture_app.session.reading.decoding import read_exif
from capture_app.session.reading.reader import Session
from reconstruction.common.geometry import Array, View
from reconstruction.scene.calibration.structure_from_motion import likely_focal_lengths, refuse_odd_lenses
from reconstruction.scene.calibration.world import metres_per_unit_by_board
from reconstruction.scene.dataset import Dataset
from tests.unit.reconstruction.conftest import (
    HEIGHT,
    VIEWS,
    WIDTH,
    Reconstruct,
    Scene,
    make_view,
    write_session,
)

UNIT = 2.5
"""Of the calibration, in metres: as structure from motion would leave it."""
ENDS = np.array([[-0.5, 0.2, 3.4], [0.6, -0.1, 3.0]])
LENGTH_M = float(np.linalg.norm(ENDS[0] - ENDS[1]))


def seen(view: View, points: Array) -> Array:
    return view.project(points @ view.rotation.T + view.translation)


def unscaled() -> Calibration:
    cameras = {}
    for name, view in VIEWS.items():
        camera = view.to_calibration()
        shrunk = tuple(value / UNIT for value in camera.translation)
        cameras[name] = msgspec.structs.replace(camera, translation=shrunk)
    return Calibration(cameras=cameras, unit="arbitrary", source="COLMAP")


def mark(name: str, shift_px: float = 0.0) -> str:
    pixels = seen(VIEWS[name], ENDS) + np.array([0, shift_px])
    numbers = ",".join(f"{value:.2f}" for value in pixels.ravel())
    return f"{name}={numbers}"


@pytest.fixture
def session(boards: Session, tmp_path: Path) -> Path:
    folder = tmp_path / "unscaled"
    shutil.copytree(boards.folder, folder)
    (folder / "calibration.json").write_bytes(msgspec.json.encode(unscaled()))
    return folder


def test_two_points_and_a_distance_set_the_scale(session: Path, reconstruct: Reconstruct) -> None:
    marks = "--mark", mark("left"), "--mark", mark("right"), "--distance-m", LENGTH_M
    arguments = "calibrate", session, "--from", "session", *marks
    assert "--replace" in reconstruct(*arguments).complaint
    done = reconstruct(*arguments, "--replace", "--json").result
    assert done["unit"] == "m"
    assert done["kept"]
    assert done["source"] == f"COLMAP; scale from a distance of {LENGTH_M:g} m"
    found = Session.open(session).calibration()
    assert found is not None
    for name, view in VIEWS.items():
        assert found.cameras[name].translation == pytest.approx(tuple(view.translation), abs=2e-3)


@pytest.mark.parametrize(
    ("marks", "problem"),
    [
        ((mark("left"),), "marked in two cameras"),
        ((mark("left"), mark("right", 40.0)), "px from where the others' marks have it"),
        ((mark("left"), "nobody=1,2,3,4"), "--mark names nobody, which the recording lacks"),
    ],
)
def test_marks_that_do_not_meet_are_refused(
    session: Path, reconstruct: Reconstruct, marks: tuple[str, ...], problem: str
) -> None:
    given = [part for one in marks for part in ("--mark", one)]
    refused = reconstruct("calibrate", session, "--from", "session", "--replace", *given, "--distance-m", 1)
    assert refused.code == 3
    assert problem in refused.complaint
    assert Session.open(session).calibration() == unscaled()


@pytest.mark.parametrize(
    "options", [("--mark", "left=1,2,3,4"), ("--distance-m", 1), ("--mark", "left=1,2", "--distance-m", 1)]
)
def test_half_a_scale_is_a_usage_error(
    session: Path, reconstruct: Reconstruct, options: tuple[object, ...]
) -> None:
    assert reconstruct("calibrate", session, "--from", "session", *options).code == 2


def test_a_board_in_the_scene_sets_the_scale() -> None:
    shrunk = {n: View.from_calibration(c, WIDTH, HEIGHT) for n, c in unscaled().cameras.items()}
    turn = cv2.Rodrigues(np.radians([60.0, 0.0, 20.0]))[0]
    lying = (DEFAULT_BOARD.places - DEFAULT_BOARD.places.mean(0)) @ turn.T + (0.0, 0.2, 1.2)
    corners = {
        (name, 0): dict(enumerate(seen(view, lying))) for name, view in VIEWS.items() if name != "aside"
    }
    factor, times = metres_per_unit_by_board(shrunk, DEFAULT_BOARD, corners)
    assert factor == pytest.approx(UNIT, rel=1e-3)
    assert times == 1
    with pytest.raises(BadInputError, match="no two cameras see the board"):
        metres_per_unit_by_board(shrunk, DEFAULT_BOARD, {("left", 0): corners["left", 0]})


def with_exif(jpeg: bytes, focal_35mm: int) -> bytes:
    """A JPEG whose EXIF says how wide its lens saw."""
    inner = struct.pack("<HHHIHHI", 1, 0xA405, 3, 1, focal_35mm, 0, 0)
    tiff = struct.pack("<2sHI", b"II", 42, 8) + struct.pack("<HHHIII", 1, 0x8769, 4, 1, 26, 0) + inner
    body = b"Exif\0\0" + tiff
    return jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + jpeg[2:]


def test_how_wide_a_lens_sees_is_read_from_exif() -> None:
    jpeg = cv2.imencode(".jpg", np.zeros((8, 8), np.uint8))[1].tobytes()
    assert read_exif(with_exif(jpeg, 26)).focal_35mm == 26
    assert read_exif(with_exif(jpeg, 0)).focal_35mm is None
    assert read_exif(jpeg).focal_35mm is None


def test_exif_that_says_to_be_a_bigtiff_far_away_is_refused() -> None:
    body = b"Exif\0\0II+\0\x08\0\0\0" + b"\xff" * 8
    with pytest.raises(ValueError, match="too large"):
        read_exif(b"\xff\xd8\xff\xe1" + struct.pack(">H", len(body) + 2) + body + b"\xff\xd9")


def test_odd_lenses_are_refused(tmp_path: Path) -> None:
    views = {"a": make_view((0, 0, 0)), "b": make_view((0.2, 0, 0))}
    dataset = Dataset(write_session(tmp_path, Scene([]), views, instants=1, calibrated=False, truth=False))
    assert likely_focal_lengths(dataset) == {}
    focal_px = likely_focal_lengths(dataset, 60.0)
    assert focal_px["a"] == pytest.approx(WIDTH / 2 / math.tan(math.radians(30)))
    wide = likely_focal_lengths(dataset, 140.0, fisheyes=True)
    assert wide["a"] == pytest.approx(WIDTH / 2 / math.radians(70))
    with pytest.raises(BadInputError, match="only with their field of view"):
        likely_focal_lengths(dataset, fisheyes=True)
    found = {name: view.to_calibration() for name, view in views.items()}
    refuse_odd_lenses(found, {})
    refuse_odd_lenses(found, focal_px)
    odd = {**found, "b": msgspec.structs.replace(found["b"], fx=100.0, fy=100.0)}
    with pytest.raises(BadInputError, match="b would see 116 degrees wide, which is unlikely") as refused:
        refuse_odd_lenses(odd, {})
    assert "reconstruct calibrate SESSION --field-of-view DEG" in str(refused.value)
    with pytest.raises(BadInputError, match="not 60 as it likely does"):
        refuse_odd_lenses(odd, focal_px)
