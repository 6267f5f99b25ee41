"""Time after which all that moves in front of a camera looks the same again, as a turning disc does."""

import cv2
import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.scene.dataset import Dataset

SIDE_PX, BLUR_PX = 160, 1.5
"""Longer side to which images are reduced, and the blur against noise and positions between two frames."""
MAX_IMAGES = 120
"""Maximum number of successive images that are compared, in the middle of the take."""
MIN_IMAGES = 6
"""Minimum number of images that are like the ones a period before."""
NOISES = 4.0
"""Multiple of the median change that is taken as noise."""
UNLIKE, ALIKE = 0.3, 0.7
"""Autocorrelation that motion falls below, and then exceeds again after its period.

Of a turning disc it is 1, or 0.76 if its period ends between two frames, and 0.3 at other times. With
something beside it that does not repeat, or has another period, it is 0.6 at most (simulated).
"""


def repetition_ms(dataset: Dataset, camera: str) -> float | None:
    """Return the period of all that moves in a camera's images, ms; None if something does not repeat.

    It is the first maximum of the images' autocorrelation, without what stands still, in steps of half a
    frame. Periods longer than the take are not seen.
    """
    there = dataset.instants(camera)
    spare = max(0, len(there) - MAX_IMAGES) // 2
    scale = SIDE_PX / max(dataset.size(camera))
    small = [
        cv2.resize(dataset.grey(camera, k), None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        for k in there[spare : spare + MAX_IMAGES]
        if dataset.has_image(camera, k)
    ]
    if len(small) <= MIN_IMAGES:
        return None
    images = np.stack([cv2.GaussianBlur(image.astype(np.float32), (0, 0), BLUR_PX) for image in small])
    images -= np.median(images, axis=0)
    images -= np.median(images, axis=(1, 2), keepdims=True)
    noise = NOISES * float(np.median(np.abs(images)))
    moving = (np.sign(images) * np.maximum(np.abs(images) - noise, 0)).reshape(len(images), -1)
    if (half_frames := _first_period(moving)) is None:
        return None
    return half_frames / 2 * dataset.period_ns / 1e6


def _first_period(moving: Array) -> int | None:
    """Return the period of images (t, n) in half frames: an image is also compared with two others' mean."""
    products = np.asarray(moving @ moving.T, float)
    lags = range(2 * (len(moving) - MIN_IMAGES))
    alike = np.array([_autocorrelation(products, lag // 2, lag % 2) for lag in lags])
    unlike = np.flatnonzero(alike < UNLIKE)
    again = [k for k in np.flatnonzero(alike > ALIKE) if len(unlike) and k > unlike[0]]
    if not again:
        return None
    # The first maximum: up to where the images differ again.
    end = next((k for k in unlike if k > again[0]), len(alike))
    return int(again[0] + alike[again[0] : end].argmax())


def _autocorrelation(products: Array, lag: int, half: int) -> float:
    """Return the correlation of images with those `lag` frames later, or with the mean of these and the next.

    `products` (t, t) are the images' scalar products.
    """
    size = len(products) - lag - half
    at = np.arange(size)
    ahead = at + lag, at + lag + half
    both = sum(products[at, later].sum() for later in ahead) / 2
    power = sum(products[one, other].sum() for one in ahead for other in ahead) / 4
    norm = float(np.sqrt(products[at, at].sum() * power))
    return float(both) / norm if norm else 0.0
