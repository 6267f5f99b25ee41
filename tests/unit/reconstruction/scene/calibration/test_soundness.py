"""Calibrations that no real camera can have are refused by name and number."""

import re
from typing import Any

import msgspec
import numpy as np
import pytest

from capture_app.session.format.calibration_judge import camera_fault, rig_faults
from reconstruction.scene.calibration.consistency import judge_calibration
from tests.unit.reconstruction.conftest import make_view

TURNED = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])


def _rows(matrix: Any) -> Any:
    return tuple(tuple(float(v) for v in row) for row in np.asarray(matrix))


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        ({"rotation": _rows(np.diag([1.0, 1, -1]))}, r"mirrored: the axes are left-handed"),
        ({"rotation": _rows(2 * TURNED)}, "its rotation matrix is not orthonormal: .* by 3"),
        ({"rotation": _rows(np.full((3, 3), 1e200))}, "its rotation matrix is not orthonormal"),
        ({"translation": (1e300, 0.0, 0.0)}, r"stands 1e\+300 units away"),
        ({"translation": (float("nan"), 0.0, 0.0)}, "not finite"),
        ({"fx": 0.0}, "focal length of 0 px"),
        ({"fy": -300.0}, "focal length of -300 px"),
        ({"fx": 1e9}, r"focal length of 1e\+09 px"),
        ({"fx": 100.0, "fy": 900.0}, "100 px across and 900 px down"),
        ({"cx": 1e9}, "far outside the picture"),
        ({"width": 0}, "0x240 pixels"),
        ({"distortion": (-5.0, 0.0, 0.0, 0.0, 0.0)}, "folds the picture"),
        ({"distortion": (1e308, 1e308)}, "folds the picture"),
        ({"distortion": (0.1,) * 8}, "8 distortion coefficients"),
        ({"distortion": (0.3, -8.0, 0.0, 0.0, 0.0), "seen_deg": 28.0}, "folds the picture 2.* degrees off"),
        ({"model": "fisheye", "distortion": (0.1,) * 5}, "5 distortion coefficients"),
    ],
)
def test_what_no_camera_has_is_refused(changed: dict[str, Any], why: str) -> None:
    sound = make_view((0.1, 0, 0)).to_calibration()
    assert re.search(why, camera_fault(msgspec.structs.replace(sound, **changed)))


@pytest.mark.parametrize(
    "changed",
    [
        {"rotation": _rows(TURNED)},
        {"translation": (5e9, 4e8, 0.0)},
        {"fx": 120.0, "fy": 118.0, "distortion": (-0.28, 0.07, 0.001, 0.0, 0.0)},
        {"fx": 3000.0, "fy": 3000.0},
        {"fx": 300.0, "fy": 600.0},
        {"distortion": ()},
        {"cx": 0.0, "cy": 0.0},
        {"cx": 1080.0, "cy": 810.0},
        {"distortion": (0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)},
        # Anipose's default, k1 alone: it folds towards the corners.
        {"fx": 190.0, "fy": 190.0, "distortion": (-0.302,)},
        # A board in the middle of the picture: the lens is sound there.
        {"distortion": (0.3, -8.0, 0.0, 0.0, 0.0), "seen_deg": 15.0},
        {"model": "fisheye", "fx": 120.0, "fy": 120.0, "distortion": (0.01, 0.0, 0.0, 0.0)},
    ],
)
def test_what_is_odd_but_possible_is_not(changed: dict[str, Any]) -> None:
    assert not camera_fault(msgspec.structs.replace(make_view((0.1, 0, 0)).to_calibration(), **changed))


def test_shared_points_are_judged_and_counted_where_they_are() -> None:
    views = {name: make_view((x, 0.0, 0.0)) for name, x in (("a", -0.2), ("b", 0.0), ("c", 0.2))}
    width, height = views["a"].width, views["a"].height
    columns, rows = np.meshgrid(np.arange(2.0, width / 8 - 1, 4), np.arange(2.0, height / 2 - 1, 4))
    many = np.column_stack([columns.ravel(), rows.ravel()])
    points = views["a"].unproject(many, np.full(len(many), 4.0))

    def pixels(name: str) -> Any:
        return views[name].project(points @ views[name].rotation.T + views[name].translation)

    shared = {("a", "b"): (many, pixels("b")), ("a", "gone"): (many, many), ("b", "c"): (many[:3], many[:3])}
    found = judge_calibration(views, shared)
    assert (found.points, found.inlier_share) == (len(many), 1.0)
    assert found.reprojection_error_px == pytest.approx(0.0, abs=1e-3)
    to_points = [points - views[name].centre for name in "ab"]
    angles = np.degrees(
        np.arccos(sum(np.prod(to_points, axis=0).T) / np.prod(np.linalg.norm(to_points, axis=2), axis=0))
    )
    assert found.triangulation_angle_deg == pytest.approx(float(np.median(angles)), rel=1e-3)
    # Upper half of the left column of 8 x 6 cells; nothing of the pairs that are left out.
    assert found.coverage["a"] == pytest.approx(3 / 48)
    assert 0 < found.coverage["b"] < 1
    assert found.coverage["c"] == 0


@pytest.mark.parametrize(("apart", "said"), [(1563.0, "1560 m"), (0.00012, "0.00012 m")])
def test_a_rig_that_is_not_in_metres_says_how_far_apart_its_cameras_stand(apart: float, said: str) -> None:
    cameras = {name: make_view((x, 0, 0)).to_calibration() for name, x in (("a", 0.0), ("b", apart))}
    (fault,) = rig_faults(cameras, "m")
    assert fault == ("", f"neighbouring cameras stand {said} apart: its unit is not the metre")
    assert not rig_faults(cameras, "mm")
