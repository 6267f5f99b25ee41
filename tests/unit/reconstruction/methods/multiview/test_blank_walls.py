"""Walls with hardly any texture: which planes there are, and that they are laid where pictures are blank."""

from dataclasses import replace

import numpy as np
import pytest

from reconstruction.common.geometry import Array, View
from reconstruction.depth.calibrated_image import CalibratedImage
from reconstruction.methods.multiview.blank_walls import (
    ScenePlane,
    evident_patches,
    extract_blank_part,
    find_scene_planes,
    own_surfaces,
)

NORMALS = np.array([[0.0, 0.0, 1.0], [0.0, 0.8, 0.6], [1.0, 0.0, 0.0]])
DISTANCES = np.array([4.0, 2.0, 1.5])


def seen_on(
    plane: ScenePlane, count: int, rng: np.random.Generator, *, off: float = 0.001, tilt: float = 0.05
) -> Array:
    """Points before a camera in the origin, off the plane by a share of their depth and some radians."""
    rays = np.column_stack([rng.uniform(-1, 1, (count, 2)), np.ones(count)])
    rays = rays[rays @ plane.normal > 0.2]
    depth = plane.distance / (rays @ plane.normal) * rng.normal(1, off, len(rays))
    normals = plane.normal + rng.normal(0, tilt, rays.shape)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return np.hstack([rays * depth[:, None], normals, np.zeros_like(rays)]).T


def test_planes_are_found_among_points_of_nothing() -> None:
    rng = np.random.default_rng(4)
    true = [ScenePlane(normal, float(d)) for normal, d in zip(NORMALS, DISTANCES, strict=True)]
    samples = [seen_on(plane, count, rng) for plane, count in zip(true, (4000, 3000, 2500), strict=True)]
    stray = rng.uniform(1, 6, (1500, 3))
    facing = rng.permutation(NORMALS[rng.integers(0, 3, 1500)])
    samples.append(np.hstack([stray, facing, np.zeros_like(stray)]).T)
    found = find_scene_planes(samples, min_points=400)
    assert len(found) == len(true)
    for plane in true:
        same = [one for one in found if abs(float(one.normal @ plane.normal)) > 0.9999]
        assert len(same) == 1
        assert abs(same[0].distance) == pytest.approx(plane.distance, rel=0.002)


def test_a_wall_among_noise_is_not_tilted_as_its_first_candidate_is() -> None:
    wall = ScenePlane(NORMALS[0], float(DISTANCES[0]))
    for seed in range(8):
        points = seen_on(wall, 5000, np.random.default_rng(seed), off=0.005, tilt=0.2)
        found = find_scene_planes([points], min_points=400)[0]
        assert np.degrees(np.arccos(abs(float(found.normal @ wall.normal)))) < 0.2


def test_near_cameras_count_for_more_in_a_plane_than_far_ones() -> None:
    flat = np.column_stack([np.random.default_rng(1).uniform(-1, 1, (2000, 2)), np.ones(2000)])
    facing = np.tile((0.0, 0.0, 1.0), (2000, 1))
    near = np.hstack([flat, facing, np.zeros_like(flat)]).T
    # From 10 m, 2 cm are a fifth of a percent; from 1 m, two.
    far = near + np.array([0, 0, 0.02, 0, 0, 0, 0, 0, -9.0])[:, None]
    found = find_scene_planes([near, far], min_points=400)[0]
    assert abs(found.distance) == pytest.approx(1.0002, abs=2e-4)


def test_a_patch_is_evident_by_its_mean_if_it_is_large_enough() -> None:
    number, likeness = np.zeros((20, 40), int), np.full((20, 40), 0.9)
    patches = {0.1: np.s_[2:8, 2:8], 0.06: np.s_[2:8, 14:20], 0.2: np.s_[2:5, 26:29]}
    for mean, patch in patches.items():
        number[patch], likeness[patch] = 1, mean
    number[12:18, 2:20], likeness[12:18, 2:20] = 2, np.where(np.arange(18) % 2, 0.0, 0.2)
    expected = (number == 2) | ((number == 1) & (likeness == 0.1))
    assert np.array_equal(evident_patches(number, likeness), expected)


def test_no_plane_is_laid_behind_a_smooth_surface_that_matches_as_well() -> None:
    """Nothing says that the object moves: its cloth is as blank as the wall behind it."""
    number, advantage, nearer = np.zeros((20, 60), int), np.zeros((20, 60)), np.zeros((20, 60))
    cloth, likely, noise, behind = (np.s_[4:16, at : at + 10] for at in (2, 16, 30, 44))
    for patch, better, front in (
        (cloth, 0.05, 0.2),
        (likely, 0.2, 0.2),
        (noise, 0.05, 0.2),
        (behind, 0.05, -0.2),
    ):
        number[patch], advantage[patch], nearer[patch] = 1, better, front
    nearer[noise] += np.random.default_rng(0).normal(0, 0.15, (12, 10))
    expected = np.zeros(number.shape, bool)
    expected[cloth] = True
    assert np.array_equal(own_surfaces(number, advantage, nearer), expected)


def test_a_plane_is_where_a_camera_sees_it() -> None:
    matrix = np.array([[300.0, 0, 99.5], [0, 300.0, 79.5], [0, 0, 1]])
    view = View(200, 160, matrix, np.zeros(5), np.eye(3), np.array([0.5, -0.2, 1.0]))
    plane = ScenePlane(NORMALS[1], float(DISTANCES[1]))
    pixel = np.array([[120.0, 100.0]])
    depth = 1 / float(plane.inverse_depth_gradient(view) @ view.rays(pixel)[0])
    assert float(view.unproject(pixel, np.array([depth]))[0] @ plane.normal) == pytest.approx(plane.distance)


def test_what_moves_is_no_wall() -> None:
    rng = np.random.default_rng(2)
    view = View(200, 160, np.diag([300.0, 300.0, 1.0]), np.zeros(5), np.eye(3), np.zeros(3))
    grey = (128 + rng.normal(0, 1, (160, 200))).astype(np.float32)
    image = CalibratedImage(view, grey, 5, 9.0)
    moving = np.zeros((160, 200), bool)
    moving[40:120, 60:100] = True
    assert extract_blank_part(image).mask.mean() > 0.95
    part = extract_blank_part(replace(image, moving=moving))
    assert not part.mask[moving].any()
    assert part.mask[~moving].mean() > 0.95
