"""One picture of a panorama's layers: exposures matched, seams cut where layers agree, blended in bands.

Gains of blocks, graph cut and multi-band blending are OpenCV's, put together as its own stitcher does.
"""

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.panorama.projection import Box, Layer, part_of

SEAM_PIXELS = 0.1e6
"""Exposures and seams are found in layers made this small: both take minutes in full pictures."""


def compose_layers(layers: Sequence[Layer], canvas: Box) -> Array:
    """The panorama (BGR, uint8) of layers (BGR), as large as the canvas; black where none sees anything."""
    largest = max(layer.seen.size for layer in layers)
    scale = min(1.0, float(np.sqrt(SEAM_PIXELS / largest)))
    small = [_shrink(layer, scale) for layer in layers]
    full = list(layers)
    # First a gain for each picture, then what is left, such as vignetting, block by block.
    for compensator in (cv2.detail.GainCompensator(), cv2.detail.BlocksGainCompensator()):
        compensator.feed(
            [layer.box[:2] for layer in small],
            [_umat(layer.picture) for layer in small],
            [_umat(_mask(layer.seen)) for layer in small],
        )
        small, full = _match_exposure(small, compensator), _match_exposure(full, compensator)
    return _blend(full, _cut_seams(small), canvas)


def average_layers(layers: Sequence[Layer], canvas: Box) -> tuple[Array, Array]:
    """The mean of layers (BGR, uint8), as large as the canvas, and how many layers see each of its pixels."""
    left, top, right, bottom = canvas
    total = np.zeros((bottom - top, right - left, 3), np.float32)
    count = np.zeros(total.shape[:2], np.uint8)
    for layer in layers:
        part = part_of(layer.box, canvas)
        total[part] += layer.picture * layer.seen[..., None]
        count[part] += layer.seen
    return (total / np.maximum(count, 1)[..., None]).astype(np.uint8), count


def _shrink(layer: Layer, scale: float) -> Layer:
    left, top = (round(side * scale) for side in layer.box[:2])
    width, height = (max(1, round(side * scale)) for side in layer.seen.shape[::-1])
    seen = cv2.resize(layer.seen.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST)
    picture = cv2.resize(layer.picture, (width, height), interpolation=cv2.INTER_AREA)
    return Layer((left, top, left + width, top + height), np.asarray(picture), np.asarray(seen) > 0)


def _match_exposure(layers: Sequence[Layer], compensator: cv2.detail.ExposureCompensator) -> list[Layer]:
    matched = []
    for i, layer in enumerate(layers):
        picture = compensator.apply(i, layer.box[:2], layer.picture.copy(), _mask(layer.seen))
        matched.append(Layer(layer.box, np.asarray(picture), layer.seen))
    return matched


def _cut_seams(layers: Sequence[Layer]) -> list[Array]:
    """Which pixels of each layer the panorama shows (uint8, 255)."""
    found = cv2.detail.GraphCutSeamFinder("COST_COLOR").find(
        [_umat(layer.picture.astype(np.float32)) for layer in layers],
        [layer.box[:2] for layer in layers],
        [_umat(_mask(layer.seen)) for layer in layers],
    )
    # One pixel more, so that rounding leaves no gap between two layers.
    return [np.asarray(cv2.dilate(share.get(), None)) for share in found]


def _blend(layers: Sequence[Layer], shares: Sequence[Array], canvas: Box) -> Array:
    left, top, right, bottom = canvas
    blender = cv2.detail.MultiBandBlender()
    blender.prepare((left, top, right - left, bottom - top))
    for layer, share in zip(layers, shares, strict=True):
        shown = cv2.resize(share, layer.seen.shape[::-1], interpolation=cv2.INTER_LINEAR) > 127
        blender.feed(layer.picture.astype(np.int16), _mask(shown & layer.seen), layer.box[:2])
    blended, _ = blender.blend(None, None)
    return np.asarray(np.clip(blended, 0, 255), np.uint8)


def _mask(pixels: Array) -> Array:
    return np.where(pixels, 255, 0).astype(np.uint8)


def _umat(pixels: Any) -> Any:
    return cv2.UMat(pixels)
