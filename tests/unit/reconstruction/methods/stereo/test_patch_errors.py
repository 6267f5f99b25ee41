"""Vertical errors of a pair's patches: found at both ends of the disparity range, and not in mere noise."""

from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from reconstruction.methods.stereo.stereo_pair import StereoPair, _patch_errors, epipolar_errors
from reconstruction.methods.stereo.stereo_study import _draw_pair
from tests.unit.reconstruction.conftest import Scene, make_view
from tests.unit.reconstruction.methods.stereo.pairs import synchronized_pair

LOWEST, COUNT, ROWS = 4, 16, 3
WIDE = cv2.GaussianBlur(np.random.default_rng(2).integers(0, 255, (160, 400)).astype(np.uint8), (0, 0), 1.5)
EVERYWHERE = np.ones((160, 300), bool)


def seen_at(disparity: int) -> Any:
    """The other image: everything so far to the left, and three rows lower."""
    return np.roll(WIDE, ROWS, axis=0)[:, 50 + disparity :][:, :300]


@pytest.mark.parametrize("disparity", [LOWEST, LOWEST + COUNT // 2, LOWEST + COUNT])
def test_patches_are_found_from_the_smallest_to_the_largest_disparity(disparity: int) -> None:
    pair: Any = SimpleNamespace(min_disparity=LOWEST, num_disparities=COUNT, scale=0.5)
    errors = _patch_errors(pair, WIDE[:, 50:350], seen_at(disparity), EVERYWHERE, EVERYWHERE, 3.0)
    assert len(errors) > 30
    # At the images' own resolution, twice that of the canvas.
    assert np.median(errors) == pytest.approx(2 * ROWS, abs=0.1)


def test_noise_has_no_patches(scene: Scene) -> None:
    pair, image, same, _ = synchronized_pair(scene, make_view((0, 0, 0)), make_view((0.2, 0, 0)))
    everywhere = np.ones(image.shape, bool)
    assert len(epipolar_errors(pair, image, same, [everywhere])[0]) > 10
    noise = np.random.default_rng(1).normal(120, 8, image.shape).astype(np.uint8)
    # The same noise in both, where the search finds it.
    moved = np.roll(noise, -round((pair.min_disparity + pair.num_disparities / 2) / pair.scale), axis=1)
    assert not epipolar_errors(pair, noise, moved, [everywhere])[0]


def test_the_picture_of_a_pair_shows_both_images_whole(scene: Scene) -> None:
    pair, image, same, _ = synchronized_pair(scene, make_view((0, 0, 0)), make_view((0.2, 0, 0)))
    assert isinstance(pair, StereoPair)
    one: Any = SimpleNamespace(matcher=pair, moving=np.zeros(image.shape, bool))
    photo, other = (cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR) for grey in (image, same))
    drawn = _draw_pair(one, photo, other)
    assert drawn.shape[0] > 0.8 * image.shape[0]
    assert drawn.shape[1] > 1.6 * image.shape[1]
