"""PSNR and SSIM against values that can be worked out by hand."""

import numpy as np
import pytest

from reconstruction.common.geometry import Array
from reconstruction.method.picture_quality import psnr, ssim


def grey(values: Array | float) -> Array:
    return np.repeat(np.broadcast_to(values, (40, 60))[..., None], 3, axis=2).astype(np.uint8)


NOISE = np.random.default_rng(3).normal(0, 20, (40, 60))


def test_two_brightnesses_are_as_similar_as_their_means() -> None:
    c = (0.01 * 255) ** 2
    assert ssim(grey(100), grey(150)) == pytest.approx((2 * 100 * 150 + c) / (100**2 + 150**2 + c), abs=1e-6)
    assert ssim(grey(100 + NOISE), grey(100 + NOISE)) == pytest.approx(1)


def test_half_the_contrast_is_four_fifths_as_similar() -> None:
    """2 x covariance / variances, of x and x / 2: 1 / (1 + 1 / 4)."""
    whole, half = grey(120 + NOISE), grey(120 + NOISE / 2)
    assert ssim(whole, half) == pytest.approx(0.8, abs=0.03)
    assert ssim(whole, grey(120 - NOISE)) < -0.7


def test_the_error_counts_where_it_is_asked_for() -> None:
    other, part = grey(100), np.zeros((40, 60), bool)
    other[:, :30], part[:, :30] = 110, True
    assert psnr(other, grey(100), part) == pytest.approx(20 * np.log10(255 / 10))
    assert psnr(other, grey(100)) == pytest.approx(20 * np.log10(255 / 10) + 10 * np.log10(2))
