"""Times after which what moves in front of a camera looks the same again, as a turning disc does."""

from collections.abc import Sequence
from itertools import product

import cv2
import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.scene.dataset import Dataset
from reconstruction.time_offsets.frame_jumps import BLUR_PX, NOISES
from reconstruction.time_offsets.rough_offset import MIN_IMAGES, first_return, reduced_image

UNLIKE, ALIKE = 0.3, 0.7
"""Autocorrelation that motion falls below, and then exceeds again after its period.

Of a turning disc it is 1, or 0.76 if its period ends between two frames, and 0.3 at other times. With
something beside it that does not repeat, or has another period, it is 0.6 at most (simulated).
"""


def middle_images(dataset: Dataset, camera: str) -> tuple[Sequence[int], Array]:
    """Return at most 120 successive instants in a take's middle, and reduced images (t, h, w)."""
    whole, limit = dataset.instants(camera), 120
    there = whole[max(0, len(whole) - limit) // 2 :][:limit]
    images = [cv2.GaussianBlur(reduced_image(dataset, camera, k), (0, 0), BLUR_PX) for k in there]
    return there, np.array(images, np.float32)


def repetitions_ms(dataset: Dataset, camera: str) -> list[float]:
    """Return the period of all that moves in a camera's images, or 0, and then other periods of parts, ms.

    A period is the first maximum of the images' autocorrelation, without what stands still, in steps of half
    a frame. Periods longer than the take are not seen. Those of parts differ by more than a frame.
    """
    there, images = middle_images(dataset, camera)
    if len(there) <= MIN_IMAGES:
        return [0.0]
    images -= np.median(images, axis=0)
    images -= np.median(images, axis=(1, 2), keepdims=True)
    noise = NOISES * np.median(np.abs(images))
    moving = images - np.clip(images, -noise, noise)
    periods = [_first_period(moving.reshape(len(images), -1))]
    # In squares of 12 px.
    rows, columns = (range(0, size, 12) for size in moving.shape[1:])
    for row, column in product(rows, columns):
        period = _first_period(moving[:, row : row + 12, column : column + 12].reshape(len(images), -1))
        if all(abs(period - other) > 2 for other in (0, *periods)):
            periods.append(period)
    spacing_ns = np.median(np.diff([dataset.record(camera, k).leader_ns for k in there]))
    return [half_frames / 2 * float(spacing_ns) / 1e6 for half_frames in periods]


def _first_period(moving: Array) -> int:
    """Return the period of images (t, n) in half frames, 0 if there is none.

    Images are compared with later ones, and with the means of two successive ones.
    """
    halves = np.repeat(moving, 2, axis=0)[:-1]
    halves[1::2] = (moving[1:] + moving[:-1]) / 2
    products = halves @ halves.T
    power = np.diagonal(products)
    # At least a third of the images are compared with those a period before.
    lags = range(2 * (len(moving) - max(MIN_IMAGES, len(moving) // 3)))
    both = [np.diagonal(products, lag)[::2].sum() for lag in lags]
    norms = [power[: len(power) - lag : 2].sum() * power[lag::2].sum() for lag in lags]
    alike = np.array(both) / np.sqrt(np.maximum(norms, 1e-9))
    return first_return(alike, UNLIKE, ALIKE)
