"""What stands still mends a calibration that is a little off, at any depth."""

from dataclasses import replace

import cv2
import numpy as np

from reconstruction.time_offsets.crossings import epipolar_errors_px
from reconstruction.time_offsets.pair_offset import LEAST_MATCHES, mend_pair
from tests.reconstruction.conftest import make_view

A, B = make_view((-0.1, 0, 0), yaw=1.5), make_view((0.1, 0.01, 0), yaw=-1.5)


def seen(depths: tuple[float, float], count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    z = rng.uniform(*depths, count)
    points = np.stack([rng.uniform(-0.4, 0.4, count) * z, rng.uniform(-0.3, 0.3, count) * z, z], axis=1)
    at_a, at_b = (view.project(points @ view.rotation.T + view.translation) for view in (A, B))
    return at_a + rng.normal(0, 0.2, at_a.shape), at_b + rng.normal(0, 0.2, at_b.shape)


def test_what_stands_still_mends_the_geometry_of_what_moves_before_it() -> None:
    turned = cv2.Rodrigues(np.array([1.5e-3, 0, 0.5e-3]))[0] @ B.rotation
    off = replace(B, rotation=turned, translation=-turned @ B.centre)
    mended = mend_pair(A, off, *seen((2.0, 5.0), 600))
    nearer = seen((1.2, 1.8), 400, seed=1)
    before, after = (float(np.abs(np.median(epipolar_errors_px(A, b, *nearer)))) for b in (off, mended))
    assert before > 0.3
    assert after < 0.1


def test_few_matches_change_nothing() -> None:
    assert mend_pair(A, B, *seen((2.0, 5.0), LEAST_MATCHES - 1)) is B
