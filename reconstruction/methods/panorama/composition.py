"""Composition of a panorama on a cylinder or sphere: exposure compensation, seams, and blending."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from reconstruction.common.geometry import Array, View

STEEPEST = 1.2
"""Tangent of the steepest direction that a cylinder shows without too much stretch."""
MAX_GROWTH = 6.0
"""Size, as a multiple of the images' pixels, above which a registration has failed."""
MAX_WIDENING = 2.0
"""Maximum width of an undistorted image, as a multiple of the image's size."""

Box = tuple[int, int, int, int]
"""Left, top, right and bottom, px of the panorama; may start below zero."""


@dataclass(frozen=True)
class Layer:
    """One image on the panorama: `box` is its position, `seen` (bool) the pixels that it covers."""

    box: Box
    picture: Array
    """Uint8, height x width (x 3); mirrored outside of `seen`."""
    seen: Array


def part_of(box: Box, canvas: Box) -> tuple[slice, slice]:
    """Return the rows and columns of a box in an array the size of a canvas."""
    left, top, right, bottom = box
    return slice(top - canvas[1], bottom - canvas[1]), slice(left - canvas[0], right - canvas[0])


class Projection:
    """Mapping from panorama pixels to image pixels, constant over all instants and conditions."""

    def __init__(self, views: Mapping[str, View]) -> None:
        """Compute the mapping from views, as `register_pictures` returns them.

        Raises:
            ValueError: the panorama would be too small or too large.
        """
        shape = "cylindrical" if max(map(_steepest, views.values())) < STEEPEST else "spherical"
        self._warper = cv2.PyRotationWarper(shape, float(np.median([view.focal for view in views.values()])))
        self.boxes = {name: self._box(view) for name, view in views.items()}
        self._refuse_misalignment(views.values())
        self._maps = {name: self._map(view) for name, view in views.items()}
        self.seen = {name: _inside(self._maps[name], view) for name, view in views.items()}

    @property
    def canvas(self) -> Box:
        """Bounding box of all images."""
        lefts, tops, rights, bottoms = zip(*self.boxes.values(), strict=True)
        return min(lefts), min(tops), max(rights), max(bottoms)

    def warp(self, name: str, image: Array) -> Layer:
        """Warp a camera's image (uint8, of its view's size) onto the panorama."""
        picture = cv2.remap(image, self._maps[name], None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        return Layer(self.boxes[name], np.asarray(picture), self.seen[name])

    def warp_mask(self, name: str, mask: Array) -> Array:
        """Warp a mask (bool) of a camera's pixels onto the panorama, in the camera's box."""
        warped = cv2.remap(mask.astype(np.uint8), self._maps[name], None, cv2.INTER_NEAREST)
        return np.asarray(warped > 0) & self.seen[name]

    def _box(self, view: View) -> Box:
        flat = _flat_view(view)
        x, y, width, height = self._warper.warpRoi((flat.width, flat.height), *_for_warper(flat))
        return x, y, x + width, y + height

    def _map(self, view: View) -> Array:
        """Return image pixels, float32 (height, width, 2), for each pixel of the view's box."""
        flat = _flat_view(view)
        _, xs, ys = self._warper.buildMaps((flat.width, flat.height), *_for_warper(flat))
        at = np.dstack([np.asarray(xs), np.asarray(ys)])
        if view.lens.is_straight:
            return at
        inside = _inside(at, flat)
        normalized = (at[inside] - flat.matrix[:2, 2]) / (flat.matrix[0, 0], flat.matrix[1, 1])
        bent = np.full_like(at, -1e4)
        bent[inside] = view.project(np.column_stack([normalized, np.ones(len(normalized))]))
        return bent

    def _refuse_misalignment(self, views: Iterable[View]) -> None:
        left, top, right, bottom = self.canvas
        width, height = right - left, bottom - top
        sizes = [(view.width, view.height) for view in views]
        too_large = width * height > MAX_GROWTH * sum(map(math.prod, sizes))
        if too_large or min(width, height) < min(map(min, sizes)) // 2:
            raise ValueError(f"the pictures do not fit together: a panorama of {width}x{height} pixels")


def _steepest(view: View) -> float:
    """Return the tangent of the steepest direction on an image's border, up or down."""
    rays = view.rays(view.border()) @ view.rotation
    return float((np.abs(rays[:, 1]) / np.maximum(np.hypot(rays[:, 0], rays[:, 2]), 1e-6)).max())


def _flat_view(view: View) -> View:
    """Return the view without distortion, large enough to contain the whole image."""
    if view.lens.is_straight:
        return view
    focal = np.array([view.matrix[0, 0], view.matrix[1, 1]])
    edge = view.rays(view.border())[:, :2] * focal
    size = np.array([view.width, view.height])
    low, high = np.maximum(edge.min(0), -MAX_WIDENING * size), np.minimum(edge.max(0), MAX_WIDENING * size)
    width, height = (int(n) for n in np.ceil(high - low) + 1)
    matrix = np.diag([*focal, 1.0])
    matrix[:2, 2] = -low
    return replace(view, width=width, height=height, matrix=matrix, distortion=np.zeros(5), is_fisheye=False)


def _for_warper(view: View) -> tuple[Array, Array]:
    """Return intrinsics and panorama-from-camera rotation in the form of OpenCV's warpers."""
    return view.matrix.astype(np.float32), np.ascontiguousarray(view.rotation.T, np.float32)


def _inside(at: Array, view: View) -> Array:
    """Return whether pixels (..., 2) are inside a view's image (bool)."""
    return np.asarray(((at > -0.5) & (at < (view.width - 0.5, view.height - 0.5))).all(-1))


def compose_layers(layers: Sequence[Layer], canvas: Box) -> Array:
    """Compose layers (BGR) into a panorama (BGR, uint8) of the canvas's size; uncovered pixels are black."""
    # Exposures and seams take minutes at full size.
    scale = min(1.0, float(np.sqrt(0.1e6 / max(layer.seen.size for layer in layers))))
    small, full = [_shrink(layer, scale) for layer in layers], list(layers)
    # First one gain per image, then the remainder, such as vignetting, block by block.
    for compensator in (cv2.detail.GainCompensator(), cv2.detail.BlocksGainCompensator()):
        compensator.feed(
            [layer.box[:2] for layer in small],
            [_umat(layer.picture) for layer in small],
            [_umat(_mask(layer.seen)) for layer in small],
        )
        small, full = _match_exposure(small, compensator), _match_exposure(full, compensator)
    return _blend(full, _cut_seams(small), canvas)


def average_layers(layers: Sequence[Layer], canvas: Box) -> tuple[Array, Array]:
    """Return the mean of layers (BGR, uint8) on the canvas, and the number of layers at each pixel."""
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
    return [
        replace(
            layer,
            picture=np.asarray(compensator.apply(i, layer.box[:2], layer.picture.copy(), _mask(layer.seen))),
        )
        for i, layer in enumerate(layers)
    ]


def _cut_seams(layers: Sequence[Layer]) -> list[Array]:
    """Return the pixels of each layer that the panorama shows (uint8, 255)."""
    masks = cv2.detail.GraphCutSeamFinder("COST_COLOR").find(
        [_umat(layer.picture.astype(np.float32)) for layer in layers],
        [layer.box[:2] for layer in layers],
        [_umat(_mask(layer.seen)) for layer in layers],
    )
    # Dilated by one pixel, so that rounding leaves no gap between two layers.
    return [np.asarray(cv2.dilate(shown.get(), None)) for shown in masks]


def _blend(layers: Sequence[Layer], masks: Sequence[Array], canvas: Box) -> Array:
    left, top, right, bottom = canvas
    blender = cv2.detail.MultiBandBlender()
    blender.prepare((left, top, right - left, bottom - top))
    for layer, mask in zip(layers, masks, strict=True):
        shown = cv2.resize(mask, layer.seen.shape[::-1], interpolation=cv2.INTER_LINEAR) > 127
        blender.feed(layer.picture.astype(np.int16), _mask(shown & layer.seen), layer.box[:2])
    blended, _ = blender.blend(None, None)
    return np.asarray(np.clip(blended, 0, 255), np.uint8)


def _mask(pixels: Array) -> Array:
    return np.where(pixels, 255, 0).astype(np.uint8)


def _umat(pixels: Any) -> Any:
    return cv2.UMat(pixels)
