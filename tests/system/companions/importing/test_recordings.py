"""Recordings become sessions: small ones made here, and real ones whose geometry must come out right."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from capture_app.common.errors import BadInputError
from capture_app.companions.importing.import_options import ImportOptions
from capture_app.session.format.calibration import CameraCalibration
from capture_app.session.reading.reader import Session
from tests.imported import import_one
from tests.unit.companions.importing.test_recordings import Array, parts, project


def triangulate(cameras: list[CameraCalibration], pixels: list[tuple[float, float]]) -> tuple[Array, Array]:
    """The point (3,) of the least algebraic error, and its distance in pixels from each observation."""
    rows = []
    for camera, pixel in zip(cameras, pixels, strict=True):
        matrix, distortion, rotation, translation = parts(camera)
        x, y = cv2.undistortPoints(np.array([[pixel]], np.float64), matrix, distortion)[0, 0]
        pose = np.hstack([rotation, translation[:, None]])
        rows += [x * pose[2] - pose[0], y * pose[2] - pose[1]]
    solution = np.linalg.svd(np.array(rows))[2][-1]
    point = solution[:3] / solution[3]
    seen = [project(camera, point[None])[0] for camera in cameras]
    return point, np.linalg.norm(np.array(seen) - np.array(pixels, np.float64), axis=1)


def ball_in(session: Session, camera: str) -> list[tuple[float, float] | None]:
    """By instant, the centre in pixels of the one blob that is brighter than the scene without it."""
    paths = [str(session.image_file(images[camera])) for images in session.images_by_instant()]
    images = np.array([cv2.imread(path, cv2.IMREAD_GRAYSCALE) for path in paths], np.int16)
    bright = (images - np.median(images, axis=0) > 20).astype(np.uint8)
    found: list[tuple[float, float] | None] = []
    for mask in bright:
        _, _, stats, centres = cv2.connectedComponentsWithStats(cv2.medianBlur(mask, 3))
        areas = stats[1:, cv2.CC_STAT_AREA]
        x, y = centres[1 + int(areas.argmax())] if areas.size else (0.0, 0.0)
        found.append((float(x), float(y)) if areas.size and areas.max() > 40 else None)
    return found


@pytest.mark.shared
def test_the_ball_of_ball_launch_is_where_both_cameras_see_it(shared: Path, tmp_path: Path) -> None:
    folder = shared / "footage" / "ball_launch"
    options = ImportOptions(fps=60, calibration=(str(folder / "calibration"),), unit="in")
    session = import_one([str(folder)], tmp_path, "ball", options)
    assert len(session.manifest.images) == 72
    assert not session.manifest.missing
    calibration = session.calibration()
    assert calibration is not None
    cameras = [calibration.cameras["L"], calibration.cameras["R"]]
    baseline_m = float(np.linalg.norm(cameras[1].translation))
    assert baseline_m == pytest.approx(0.517, abs=0.001)

    left, right = ball_in(session, "L"), ball_in(session, "R")
    errors: dict[int, list[float]] = {0: [], 4: []}
    for late, of in errors.items():
        for one, other in zip(left[4:19], right[4 + late :], strict=False):
            if one and other:
                of.append(float(triangulate(cameras, [one, other])[1].mean()))
    assert len(errors[0]) > 8
    assert np.median(errors[0]) < 0.6
    assert np.median(errors[4]) > 2.5


@pytest.mark.shared
def test_a_man_on_a_beam_stands_on_the_floor_of_his_room(shared: Path, tmp_path: Path) -> None:
    folder = shared / "footage" / "pose2sim_balancing"
    qca = str(folder / "calibration" / "Calib.qca.txt")
    options = ImportOptions(fps=60, count=4, calibration=(qca,))
    with pytest.raises(
        BadInputError, match="cam01 is calibrated for 1088x1920 pixels, its images are 1080x1920"
    ):
        import_one([str(folder / "videos")], tmp_path, "beam", options)
    options = ImportOptions(fps=60, count=4, calibration=(qca,), fit="crop")
    session = import_one([str(folder / "videos")], tmp_path, "beam", options)
    calibration = session.calibration()
    assert calibration is not None
    cameras = [calibration.cameras[f"cam0{n}"] for n in (1, 2, 3, 4)]

    # Read off the first frames by eye, to 3 pixels; the top of the round cap to 15.
    cap, cap_px = triangulate(cameras, [(490, 331), (532, 399), (617, 419), (264, 485)])
    assert cap_px.max() < 20
    assert cap[2] == pytest.approx(1.7, abs=0.05)
    near_right, right_px = triangulate(cameras[:2], [(279.3, 1361), (283.7, 1213.6)])
    near_left, left_px = triangulate(cameras[:2], [(786, 1277.2), (802.9, 1267.7)])
    far_left, far_left_px = triangulate(cameras[2:], [(519.9, 1499.4), (325.1, 1463.6)])
    far_right, far_right_px = triangulate(cameras[2:], [(912.2, 1226.7), (884.9, 1429.6)])
    assert max(e.max() for e in (right_px, left_px, far_left_px, far_right_px)) < 10
    bolts = np.array([near_right, near_left, far_left, far_right])
    assert abs(bolts[:, 2]).max() < 0.05  # metres above the floor of the treadmill
    across = np.linalg.norm(bolts[[1, 2]] - bolts[[0, 3]], axis=1)
    assert across[0] == pytest.approx(across[1], rel=0.03)
