"""What a calibration that is off does to what lies on epipolar lines is what its terms say."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from reconstruction.common.geometry import epipolar_errors_px
from reconstruction.time_offsets.crossings import Crossings, fit_offset, points_at_offset, still_errors
from reconstruction.time_offsets.pair_geometry import (
    correct_views,
    geometry_terms,
    other_calibrations,
)
from tests.unit.reconstruction.conftest import make_view

A, B = make_view((-0.1, 0, 0), yaw=1.5), make_view((0.1, 0.01, 0), yaw=-1.5)


def seen(depths: tuple[float, float], count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (n, 2) of points before both cameras."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(*depths, count)
    points = np.stack([rng.uniform(-0.4, 0.4, count) * z, rng.uniform(-0.3, 0.3, count) * z, z], axis=1)
    at_a, at_b = (view.project(points @ view.rotation.T + view.translation) for view in (A, B))
    return at_a + rng.normal(0, 0.2, at_a.shape), at_b + rng.normal(0, 0.2, at_b.shape)


def test_a_calibration_that_is_off_is_told_from_lateness_by_what_stands_still() -> None:
    turned = cv2.Rodrigues(np.array([1.5e-3, 0, 0.5e-3]))[0] @ B.rotation
    off = replace(B, rotation=turned, translation=-turned @ B.centre)
    nearer = seen((1.2, 1.8), 400, seed=1)
    rng = np.random.default_rng(2)
    speed = rng.uniform(0.2, 0.4, 400)
    errors = epipolar_errors_px(A, off, *nearer)
    assert abs(np.median(errors)) > 0.3
    instants = rng.integers(0, 8, 400)
    terms = geometry_terms(A, off, *nearer)
    moving = Crossings(instants, errors / speed, speed, np.ones(400), np.zeros(400), terms, instants)
    found = fit_offset(moving, still_errors((A, off), *seen((2.0, 5.0), 600)), 33.0)
    assert found.offset_ms is not None
    assert found.sd_ms is not None
    assert abs(found.offset_ms) < 2 * found.sd_ms
    assert found.sd_ms < 0.8


def test_the_terms_are_those_of_the_direction_between_the_cameras_too() -> None:
    at_a, at_b = seen((1.5, 6.0), 300)
    aside = replace(B, translation=B.translation + np.array([0.0, 0.002, 0.0]))
    change = epipolar_errors_px(A, aside, at_a, at_b) - epipolar_errors_px(A, B, at_a, at_b)
    terms = geometry_terms(A, B, at_a, at_b)
    left = change - terms @ np.linalg.lstsq(terms, change)[0]
    assert np.std(left) < 0.05 * np.std(change)


def test_matches_of_moving_cameras_are_on_their_lines_only_at_the_right_offset() -> None:
    """B's points move by 2 px down a frame of 20 ms, and are 8 ms late."""
    at_a, at_b = seen((1.5, 6.0), 50)
    down = np.array([0.0, 2.0])
    times_ms = np.tile(np.array([-20.0, 0.0, 20.0])[:, None], 50)
    a = np.stack([at_a - down, at_a, at_a + down]), times_ms
    late = at_b + 0.4 * down
    b = np.stack([late - down, late, late + down]), times_ms
    right, wrong = (epipolar_errors_px(A, B, *points_at_offset(a, b, ms)[:2]) for ms in (8.0, 0.0))
    at_once = epipolar_errors_px(A, B, at_a, at_b)
    assert np.abs(right - at_once).max() < 0.01
    assert np.median(np.abs(wrong - at_once)) > 0.3


FAULTS = {
    "turned": replace(B, rotation=cv2.Rodrigues(np.array([0.02, 0.01, -0.02]))[0] @ B.rotation),
    "zoomed": replace(B, matrix=B.matrix * np.array([[1.04], [1.04], [1.0]])),
    "moved": replace(B, translation=B.translation + np.array([0.0, 0.012, 0.02])),
    "another middle": replace(B, matrix=B.matrix + np.array([[0, 0, 0], [0, 0, 12.0], [0, 0, 0]])),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_calibration_pixels_off_is_corrected_by_what_stands_still(fault: str) -> None:
    off, nearer = FAULTS[fault], seen((1.2, 1.8), 400, seed=1)
    assert np.median(np.abs(epipolar_errors_px(A, off, *nearer))) > 1.5
    found = correct_views((A, off), *seen((2.0, 5.0), 600))
    assert found is not None
    assert np.median(np.abs(epipolar_errors_px(*found[0], *nearer))) < 0.4


def test_matches_that_fit_no_geometry_correct_nothing() -> None:
    at_a, at_b = seen((2.0, 5.0), 300)
    assert correct_views((A, B), at_a, np.random.default_rng(0).permutation(at_b)) is None
    assert correct_views((A, B), at_a[:5], at_b[:5]) is None
    mirrored = replace(B, matrix=B.matrix * np.array([[1.0], [2.0], [1.0]]))
    assert correct_views((A, mirrored), at_a, at_b) is None


def test_a_lens_that_bends_is_corrected_too() -> None:
    bent, nearer = replace(B, distortion=np.array([0.3, 0, 0, 0, 0])), seen((1.2, 1.8), 400, seed=1)
    before = np.abs(epipolar_errors_px(A, bent, *nearer))
    found = correct_views((A, bent), *seen((2.0, 5.0), 600))
    assert found is not None
    after = np.abs(epipolar_errors_px(*found[0], *nearer))
    assert np.percentile(before, 90) > 2
    assert np.percentile(after, 90) < 0.7
    assert found[0][1].distortion[0] < 0.15


def test_matches_say_whether_they_leave_a_correction_open() -> None:
    """A far point on a line cannot tell a turn from a move: what the prior allows, it keeps."""
    off = FAULTS["turned"]
    correction = correct_views((A, off), *seen((2.0, 5.0), 600))
    assert correction is not None
    (first, second), late_ms, sd_ms = correction
    assert (late_ms, sd_ms) == (0, pytest.approx(1))
    assert np.linalg.norm(second.centre - first.centre) == pytest.approx(
        np.linalg.norm(off.centre - A.centre), rel=1e-6
    )
    turn = cv2.Rodrigues(np.array([0.25, 0, 0]))[0]
    far = replace(B, rotation=turn @ B.rotation, translation=turn @ B.translation)
    assert correct_views((A, far), *seen((2.0, 5.0), 600)) is None


def test_other_calibrations_fit_what_stands_still_by_other_focal_lengths() -> None:
    still = seen((2.0, 5.0), 300)
    others = other_calibrations((A, B), *still)
    factors = sorted((round(a.focal / A.focal, 2), round(b.focal / B.focal, 2)) for a, b in others)
    assert {*factors} <= {(0.7, 0.7), (1.4, 1.4), (0.87, 1.15), (1.15, 0.87)}
    assert len(factors) >= 2
    for pair in others:
        assert np.median(np.abs(epipolar_errors_px(*pair, *still))) < 0.5
    assert other_calibrations((A, B), still[0], np.random.default_rng(0).permutation(still[1])) == []
