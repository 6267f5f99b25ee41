"""Positions from pixels, their covariance, and what is left out."""

import numpy as np

from benchmarks.people.figure import pixels_of, ring
from reconstruction.methods.people.joint_positions import (
    locate,
    locate_with_jackknife,
    pixel_noise,
    radius_95,
    squared_noise,
)

VIEWS = ring(4, 120)
PROJECTIONS = np.array([view.matrix @ np.column_stack([view.rotation, view.translation]) for view in VIEWS])
POINTS = np.random.default_rng(1).uniform([-0.5, -0.5, 0.2], [0.5, 0.5, 1.7], (400, 3))
PIXELS = np.array([pixels_of(view, POINTS) for view in VIEWS])


def test_points_without_noise_are_exact() -> None:
    found = locate(PROJECTIONS, PIXELS, np.ones(PIXELS.shape[:2]))
    assert np.abs(found.points - POINTS).max() < 1e-6
    assert (found.cameras == 4).all()


def test_a_wrong_camera_is_left_out() -> None:
    wrong = PIXELS.copy()
    wrong[2] += 300
    found = locate(PROJECTIONS, wrong, np.ones(PIXELS.shape[:2]))
    assert (found.cameras == 3).all()
    assert np.abs(found.points - POINTS).max() < 0.01


def test_two_cameras_that_disagree_give_nothing() -> None:
    wrong = PIXELS[:2].copy()
    wrong[1, :, 1] += 120
    assert np.isnan(locate(PROJECTIONS[:2], wrong, np.ones((2, 400))).points).all()


def test_an_error_holds_the_truth_where_two_of_three_cameras_agree_by_chance() -> None:
    rng = np.random.default_rng(3)
    pixels = PIXELS[:3] + rng.normal(0, 2, PIXELS[:3].shape)
    # What the third camera sees is half a metre farther along the first one's ray.
    ray = POINTS - VIEWS[0].centre
    pixels[2] = pixels_of(VIEWS[2], POINTS + 0.5 * ray / np.linalg.norm(ray, axis=1, keepdims=True))
    variances = np.full(pixels.shape[:2], 4.0)
    within = []
    for located in (locate, locate_with_jackknife):
        found = located(PROJECTIONS[:3], pixels, variances)
        away = np.linalg.norm(found.points - POINTS, axis=1)
        within.append(float((away <= radius_95(found.covariance)).mean()))
    assert within[0] < 0.8
    assert within[1] > 0.9


def test_the_noise_of_pixels_is_found_by_residuals_beside_outliers() -> None:
    noise = np.array([2.0, 6.0])
    pixels = np.repeat(PIXELS, 2, axis=1)
    pixels += np.random.default_rng(4).normal(0, 1, pixels.shape) * np.tile(noise, 400)[:, None]
    pixels[1, ::7] += 90
    guess = np.full(2, 4.0)
    for _ in range(4):
        found = locate(PROJECTIONS, pixels, np.tile(guess**2, (4, 400)))
        guess = pixel_noise(squared_noise(found, guess), pixels.swapaxes(0, 1))
    assert np.abs(guess / noise - 1).max() < 0.1
    rare = np.where([[True, False]] * 19 + [[True, True]] * 3, 4.0, np.nan)
    assert pixel_noise(rare, pixels)[1] == pixel_noise(rare, pixels)[0] == 2.0


def test_a_camera_alone_gives_nothing() -> None:
    alone = np.full_like(PIXELS, np.nan)
    alone[0] = PIXELS[0]
    found = locate(PROJECTIONS, alone, np.ones(PIXELS.shape[:2]))
    assert np.isnan(found.points).all()
    assert not found.cameras.any()


def test_the_radius_holds_95_percent() -> None:
    rng = np.random.default_rng(2)
    for scales in ([1, 1, 1], [5, 1, 1], [9, 3, 0.1]):
        covariance = np.diag(np.square(scales)).astype(float)[None]
        drawn = rng.normal(0, 1, (40_000, 3)) * scales
        assert 0.94 < (np.linalg.norm(drawn, axis=1) < radius_95(covariance)[0]).mean() < 0.96
