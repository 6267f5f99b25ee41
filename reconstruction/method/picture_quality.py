"""How like a picture is to another one of the same view: PSNR and SSIM."""

import cv2
import numpy as np

from reconstruction.common.geometry import Array

_WINDOW, _SIGMA = 11, 1.5
_MEANS, _VARIANCES = (0.01 * 255) ** 2, (0.03 * 255) ** 2


def psnr(picture: Array, truth: Array, where: Array | None = None) -> float:
    """Return the peak signal-to-noise ratio, dB, of uint8 pictures, at the pixels `where` (bool) if given."""
    error = (picture.astype(np.float64) - truth) ** 2
    return float(10 * np.log10(255**2 / max((error if where is None else error[where]).mean(), 1e-9)))


def ssim(picture: Array, truth: Array) -> float:
    """Return the mean structural similarity of the grey levels of BGR pictures (Wang et al. 2004)."""
    a, b = (cv2.cvtColor(colours, cv2.COLOR_BGR2GRAY).astype(np.float64) for colours in (picture, truth))

    def mean(image: Array) -> Array:
        return np.asarray(cv2.GaussianBlur(image, (_WINDOW, _WINDOW), _SIGMA))

    mean_a, mean_b = mean(a), mean(b)
    covariance = mean(a * b) - mean_a * mean_b
    variances = mean(a * a) - mean_a**2 + mean(b * b) - mean_b**2
    above = (2 * mean_a * mean_b + _MEANS) * (2 * covariance + _VARIANCES)
    return float((above / ((mean_a**2 + mean_b**2 + _MEANS) * (variances + _VARIANCES))).mean())
