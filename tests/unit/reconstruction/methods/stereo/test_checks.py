"""Checks on depth: weak grey walls keep theirs, moved objects lose it, and the horizon has no finite one."""

import cv2
import numpy as np
import pytest

from reconstruction.common.geometry import Array
from reconstruction.methods.stereo.matching import residual_displacement, same_brightness
from reconstruction.methods.stereo.stereo_pair import ACCURACY_PX, MAX_RESIDUAL_PX, StereoPair
from tests.unit.reconstruction.conftest import make_view

HEIGHT, WIDTH = 240, 320
REFERENCE, OTHER = make_view((0, 0, 0)), make_view((0.2, 0, 0))
FOCAL_BASELINE = REFERENCE.focal * 0.2
NEAR = 26.0


def clouds(rng: np.random.Generator, contrast: float) -> Array:
    """Soft grey texture of this standard deviation, grey levels, 80 px wider than a picture."""
    image = np.zeros((HEIGHT, WIDTH + 80), np.float32)
    for cell in (64, 32, 16, 8, 4):
        grains = rng.standard_normal((HEIGHT // cell + 2, (WIDTH + 80) // cell + 2)).astype(np.float32)
        image += np.sqrt(cell) * cv2.resize(grains, image.shape[::-1], interpolation=cv2.INTER_CUBIC)
    return image / image.std() * contrast


def wall_and_box(seed: int, contrast: float, shift: float) -> tuple[Array, Array, Array]:
    """A wall of this contrast and disparity behind a textured box: both pictures, and the true disparity."""
    rng = np.random.default_rng(seed)
    wall, box = 120 + clouds(rng, contrast), 120 + clouds(rng, 35)
    ys, xs = np.indices((HEIGHT, WIDTH), np.float32)
    pictures = []
    for behind, before in ((0.0, 0.0), (shift, NEAR)):
        in_box = (np.abs(xs + before - 170) < 35) & (ys > 90) & (ys < 200)
        seen = np.where(
            in_box,
            cv2.remap(box, xs + before + 30, ys, cv2.INTER_CUBIC),
            cv2.remap(wall, xs + behind + 30, ys, cv2.INTER_CUBIC),
        )
        noisy = np.round(seen + rng.normal(0, 0.5, seen.shape))
        pictures.append(np.clip(noisy, 0, 255).astype(np.uint8))
    in_box = (np.abs(xs - 170) < 35) & (ys > 90) & (ys < 200)
    return pictures[0], pictures[1], np.where(in_box, NEAR, shift)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_weak_grey_wall_keeps_its_right_depth(seed: int) -> None:
    """Before displacements were weighed by the visible texture, 32 and 30 % were right."""
    left, right, truth = wall_and_box(seed, contrast=1.0, shift=10.0)
    depth = StereoPair(REFERENCE, OTHER, (0, 46)).compute_depth(left, right).depth
    given = depth > 0
    found = np.abs(FOCAL_BASELINE / np.maximum(depth, 1e-6) - truth) <= 2
    assert (given & found).mean() > 0.52
    assert found[given].mean() > 0.9


def test_what_is_too_far_for_a_disparity_has_no_finite_depth() -> None:
    left, right, truth = wall_and_box(3, contrast=20.0, shift=0.0)
    found = StereoPair(REFERENCE, OTHER, (0, 46)).compute_both(left, right)[1]
    least = FOCAL_BASELINE / ACCURACY_PX
    assert found.depth.max() <= least
    assert found.filled.max() == pytest.approx(least, rel=1e-4)
    horizon = truth == 0
    assert (found.depth[horizon] == 0).mean() > 0.9
    assert (found.filled[horizon] == found.filled.max()).mean() > 0.8
    box = FOCAL_BASELINE / np.maximum(found.depth[~horizon], 1e-6)
    assert (np.abs(box - NEAR) < 1).mean() > 0.95


def test_a_wall_hidden_by_a_seen_box_has_the_depth_beside_it() -> None:
    """Before, 1 % of it had one."""
    left, right, _ = wall_and_box(1, contrast=20.0, shift=10.0)
    depth = StereoPair(REFERENCE, OTHER, (0, 46)).compute_both(left, right)[1].depth
    # The box begins at column 135, and hides NEAR - 10 columns of the wall from the other camera.
    hidden = FOCAL_BASELINE / np.maximum(depth[95:195, 121:133], 1e-6)
    assert (np.abs(hidden - 10.0) < 1).mean() > 0.9


def test_a_displacement_counts_where_texture_shows_it() -> None:
    rng = np.random.default_rng(5)
    for contrast, rows, visible in ((20.0, 3, True), (20.0, 0, False), (0.1, 3, False)):
        image = 120 + clouds(rng, contrast)
        a, b = (
            np.clip(np.round(one + rng.normal(0, 0.5, one.shape)), 0, 255).astype(np.uint8)
            for one in (image, np.roll(image, rows, axis=0))
        )
        moved = residual_displacement(a, b)[20:-20, 20:-20] > MAX_RESIDUAL_PX
        assert moved.mean() > 0.95 if visible else moved.mean() < 0.02


def test_conditions_are_compared_by_stricter_checks_than_a_pair_alone() -> None:
    left, right, _ = wall_and_box(1, contrast=20.0, shift=10.0)
    down = np.array([[1, 0, 0], [0, 1, 0.8]])
    lower = cv2.warpAffine(right, down, (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC)
    pair = StereoPair(REFERENCE, OTHER, (0, 46))
    assert (pair.compute_depth(left, lower).depth > 0).mean() < 0.3
    assert (pair.compute_both(left, lower)[1].depth > 0).mean() > 0.9


def test_a_reflection_that_one_camera_sees_keeps_its_depth() -> None:
    """Before, none of it had one: the brightness differs, the texture does not."""
    left, right, truth = wall_and_box(1, contrast=20.0, shift=10.0)
    shine = np.zeros((HEIGHT, WIDTH), np.float32)
    shine[30:80, 150:260] = 45.0
    bright = np.clip(right + shine, 0, 255).astype(np.uint8)
    depth = StereoPair(REFERENCE, OTHER, (0, 46)).compute_both(left, bright)[1].depth
    off = np.abs(FOCAL_BASELINE / np.maximum(depth, 1e-6) - truth)[35:75, 170:260]
    assert (off < 1).mean() > 0.9


def test_half_a_pixel_at_an_edge_is_no_difference() -> None:
    edge = np.full((40, 40), 30, np.float32)
    edge[:, 20:] = 200
    sharp = cv2.GaussianBlur(edge, (0, 0), 0.8)
    for shift, same in ((0.5, True), (3.0, False)):
        move = np.array([[1, 0, shift], [0, 1, 0]])
        shifted = cv2.warpAffine(
            sharp, move, sharp.shape, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
        )
        assert same_brightness(sharp, shifted).all() == same
