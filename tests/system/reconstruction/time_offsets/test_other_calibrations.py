"""Calibrations that fit points at rest as well as the one that is given."""

import numpy as np
import pytest

from reconstruction.common.geometry import epipolar_errors_px
from reconstruction.time_offsets.pair_geometry import other_calibrations
from tests.unit.reconstruction.time_offsets.test_pair_geometry import A, B, seen


def test_other_focal_lengths_that_fit_points_at_rest_come_with_their_own_poses() -> None:
    """Two cameras side by side in a room: both focal lengths may be 30 % off, and the points fit as well."""
    at_a, at_b = seen((2.0, 5.0), 600)
    found = other_calibrations((A, B), at_a, at_b)
    factors = [
        tuple(view.focal / own.focal for view, own in zip(pair, (A, B), strict=True)) for pair in found
    ]
    assert (pytest.approx(0.7), pytest.approx(0.7)) in factors
    for a, b in found:
        assert np.median(np.abs(epipolar_errors_px(a, b, at_a, at_b))) < 0.5
        np.testing.assert_allclose(a.matrix[:2, 2], A.matrix[:2, 2])
