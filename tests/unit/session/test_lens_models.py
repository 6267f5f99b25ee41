"""Lenses: pixels, rays and redrawn images of both models, up to where each is one-to-one."""

import cv2
import numpy as np
import pytest

from capture_app.session.format.lens import OUTSIDE, Lens

MATRIX = np.array([[760.0, 0, 639.5], [0, 760.0, 511.5], [0, 0, 1]])
ANIPOSE = np.array([-0.302, 0.0, 0.0, 0.0, 0.0])
"""What Anipose fits by default: k1 alone, which folds within the picture."""
FISHEYE = np.array([-0.02, 0.004, -0.003, 0.0005])


def grid(width: int = 1280, height: int = 1024) -> np.ndarray:
    across, down = np.meshgrid(np.linspace(0, width - 1, 21), np.linspace(0, height - 1, 17))
    return np.column_stack([across.ravel(), down.ravel()])


@pytest.mark.parametrize(
    ("distortion", "is_fisheye"),
    [
        (np.array([-0.28, 0.07, 0.001, -0.002, 0.0]), False),
        (np.array([-0.302, 0.0, 0.001, -0.002, 0.0]), False),
        (FISHEYE, True),
        (np.zeros(4), True),
    ],
)
def test_known_pixels_come_back(distortion: np.ndarray, is_fisheye: bool) -> None:
    lens = Lens(MATRIX, distortion, is_fisheye)
    pixels = grid()[lens.known(grid())]
    assert len(pixels) > 150
    assert np.abs(lens.project(lens.rays(pixels)) - pixels).max() < 1e-6


def test_a_fisheye_is_opencvs() -> None:
    lens = Lens(np.array([[330.0, 0, 639.5], [0, 331.0, 511.5], [0, 0, 1]]), FISHEYE, True)
    rays = lens.rays(grid())
    points = np.column_stack([rays, np.ones(len(rays))])[:, None]
    seen, _ = cv2.fisheye.projectPoints(points, np.zeros(3), np.zeros(3), lens.matrix, lens.distortion)
    known = lens.known(grid())
    assert 0.4 < known.mean() < 1.0
    assert np.abs(seen[known, 0] - grid()[known]).max() < 1e-6


def test_beyond_the_fold_pixels_are_unknown_and_rays_do_not_come_back_into_the_picture() -> None:
    lens = Lens(MATRIX, ANIPOSE)
    assert lens.limit[1] * 760 == pytest.approx(0.70 * 760, rel=0.01)
    assert lens.known(np.array([[639.5, 100.0], [639.5, 0.0], [100.0, 100.0]])).tolist() == [
        True,
        True,
        False,
    ]
    far = lens.project(np.array([[1.0, 0.0], [1.5, 0.0], [3.0, 0.0]]))[:, 0]
    assert (np.diff(far) > 0).all()
    xs, _ = lens.maps((1280, 1024), MATRIX)
    assert xs[0, 0] == OUTSIDE
    assert xs[512, 640] == pytest.approx(640, abs=0.01)


def test_a_fisheye_is_redrawn_straight() -> None:
    lens = Lens(np.array([[330.0, 0, 639.5], [0, 330.0, 511.5], [0, 0, 1]]), FISHEYE, True)
    flat = np.array([[400.0, 0, 319.5], [0, 400.0, 239.5], [0, 0, 1]])
    turned = cv2.Rodrigues(np.array([0.0, 0.3, 0.1]))[0]
    xs, ys = lens.maps((640, 480), flat, turned)
    ray = turned.T @ np.linalg.inv(flat) @ [100, 50, 1]
    expected = lens.project((ray[:2] / ray[2])[None])[0]
    assert [xs[50, 100], ys[50, 100]] == pytest.approx(expected, abs=1e-3)
