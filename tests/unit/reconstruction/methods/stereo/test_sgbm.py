"""Matching of pictures of any size and range, the same each time, seen from either side."""

import cv2
import numpy as np
import pytest

from reconstruction.methods.stereo.matching import match_rectified, match_rectified_back


@pytest.mark.parametrize("height", [1, 3, 17])
@pytest.mark.parametrize(("low", "count"), [(0, 16), (7, 48), (200, 160)])
def test_pictures_of_any_size_are_matched_or_have_no_disparity(height: int, low: int, count: int) -> None:
    rng = np.random.default_rng(height)
    for width in (1, 16, low + count, low + count + 1, low + count + 40):
        a, b = rng.integers(0, 255, (2, height, width)).astype(np.uint8)
        for match in (match_rectified, match_rectified_back):
            found = match(a, b, low, count)
            assert found.shape == a.shape
            assert np.array_equal(found, match(a, b, low, count), equal_nan=True)
            known = found[np.isfinite(found)]
            assert ((known >= low) & (known <= low + count)).all()
        assert width > low + count or not np.isfinite(match_rectified(a, b, low, count)).any()


@pytest.mark.parametrize("low", [0, 24])
def test_both_directions_find_a_shift_on_their_own_pixels(low: int) -> None:
    rng = np.random.default_rng(8)
    wide = cv2.GaussianBlur(rng.integers(0, 255, (60, 200)).astype(np.uint8), (0, 0), 1.0)
    shift = low + 9
    reference, other = wide[:, : 200 - shift], wide[:, shift:]
    forward = match_rectified(reference, other, low, 16)
    backward = match_rectified_back(reference, other, low, 16)
    # A few pixels at the edge lack half of what a gradient is made of.
    assert np.abs(forward[:, low + 20 : -4] - shift).max() < 0.3
    assert np.abs(backward[:, 4 : -low - 20] - shift).max() < 0.3
