"""Rectification: same point, same row, whatever way the two cameras stand."""

import numpy as np
import pytest

from reconstruction.common.geometry import View
from reconstruction.methods.stereo.stereo_pair import rectify
from reconstruction.scene.pairs import rectifying_rotations
from tests.unit.reconstruction.conftest import make_view

PAIRS = {
    "side by side": (make_view((0, 0, 0)), make_view((0.2, 0, 0))),
    "swapped": (make_view((0.2, 0, 0)), make_view((0, 0, 0))),
    "one above the other": (make_view((0, 0, 0)), make_view((0, 0.2, 0))),
    "one below the other": (make_view((0, 0.2, 0), yaw=3), make_view((0, 0, 0))),
    "converging, rolled, uneven": (
        make_view((0, 0, 0), yaw=6, roll=4),
        make_view((0.3, 0.05, -0.04), yaw=-8, pitch=3),
    ),
    "distorted": (
        make_view((0, 0, 0), distortion=(-0.2, 0.05, 0.002, -0.001, 0.01)),
        make_view((0.2, 0, 0), yaw=-2, distortion=(-0.25, 0.1, 0, 0.002, 0)),
    ),
    "in inches": (make_view((0, 0, 0), unit=39.37), make_view((0.5, 0, 0), unit=39.37)),
}


@pytest.mark.parametrize(("reference", "other"), PAIRS.values(), ids=PAIRS.keys())
def test_a_point_lies_in_one_row_and_its_disparity_gives_its_depth(reference: View, other: View) -> None:
    unit = 39.37 if np.linalg.norm(other.centre) > 5 else 1.0
    rng = np.random.default_rng(7)
    points = rng.uniform((-0.5, -0.4, 2.0), (0.5, 0.4, 6.0), (200, 3)) * unit
    canvas = rectify(reference, other, (0.0, 80.0))
    in_reference = points @ reference.rotation.T + reference.translation
    in_other = points @ other.rotation.T + other.translation
    a = canvas.project(in_reference)
    b = canvas.project(in_other, other=True)
    assert np.abs(a[:, 1] - b[:, 1]).max() < 1e-6
    disparity = a[:, 0] - b[:, 0]
    assert (disparity > 0).all()
    depth = (in_reference @ canvas.rotations[0].T)[:, 2]
    assert np.allclose(disparity, canvas.focal * canvas.baseline / depth)


@pytest.mark.parametrize("x", [0.2, -0.2])
def test_a_rectified_pair_is_not_resampled(x: float) -> None:
    matrix = np.array([[300.0, 0, 159.5], [0, 300.0, 119.5], [0, 0, 1]])
    reference, other = (
        View(320, 240, matrix, np.zeros(5), np.eye(3), np.array([-at, 0.0, 0.0])) for at in (0.0, x)
    )
    image = np.random.default_rng(1).integers(0, 255, (240, 320)).astype(np.uint8)
    canvas, seen = rectify(reference, other, (0.0, 80.0)).remap(image)
    ys, xs = np.nonzero(seen)
    shown = canvas[ys.min() : ys.max() + 1, xs.min() : xs.max() + 1]
    assert (shown[:, :: 1 if x > 0 else -1] == image[1:-1, 1:-1]).all()


def test_pictures_stay_upright() -> None:
    for reference, other in (PAIRS["side by side"], PAIRS["swapped"]):
        turn, _, _, _ = rectifying_rotations(reference, other)
        assert turn[0, 0] > 0.9
        assert turn[1, 1] > 0.9


def test_two_cameras_at_one_place_or_in_a_line_are_refused() -> None:
    with pytest.raises(ValueError, match="same place"):
        rectifying_rotations(make_view((0, 0, 0)), make_view((0, 0, 0), yaw=5))
    with pytest.raises(ValueError, match="behind"):
        rectifying_rotations(make_view((0, 0, 0)), make_view((0, 0, 1)))
