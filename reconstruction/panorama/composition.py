"""A panorama's layers on a cylinder or a sphere: exposures matched, seams cut where they agree, blended."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from reconstruction.common.geometry import Array, View

STEEPEST = 1.2
"""Tangent of the steepest direction that a cylinder shows without stretching it too much."""
MAX_GROWTH = 6.0
"""A panorama of so many times its pictures' pixels is a failed registration."""
MAX_WIDENING = 2.0
"""How much wider than its picture a lens's distortion may be drawn, undone."""

Box = tuple[int, int, int, int]
"""Left, top, right and bottom, px of the panorama; it may begin below zero."""
SEAM_PIXELS = 0.1e6
"""Exposures and seams are found in layers made this small: both take minutes in full pictures."""


@dataclass(frozen=True)
class Layer:
    """One picture on the panorama: `box` is where, `seen` (bool) which pixels of it the picture has."""

    box: Box
    picture: Array
    """Uint8, height x width (x 3); mirrored where it is not seen."""
    seen: Array


def part_of(box: Box, canvas: Box) -> tuple[slice, slice]:
    """Rows and columns of a box in an array as large as a canvas."""
    left, top, right, bottom = box
    return slice(top - canvas[1], bottom - canvas[1]), slice(left - canvas[0], right - canvas[0])


class Projection:
    """Where every pixel of a panorama looks in every picture, the same for all instants and conditions."""

    def __init__(self, views: Mapping[str, View]) -> None:
        """`views` as `register_pictures` gives them.

        Raises:
            ValueError: the panorama would be too small or too large.
        """
        self._views = dict(views)
        rise = max(_steepest(view) for view in views.values())
        scale = float(np.median([view.focal for view in views.values()]))
        self._warper = cv2.PyRotationWarper("cylindrical" if rise < STEEPEST else "spherical", scale)
        self.boxes = {name: self._box(view) for name, view in views.items()}
        self._refuse_misfit()
        self._maps = {name: self._map(view) for name, view in views.items()}
        self.seen = {name: _inside(self._maps[name], view) for name, view in views.items()}

    @property
    def canvas(self) -> Box:
        """The box that holds all pictures."""
        sides = np.array(list(self.boxes.values()))
        left, top = (int(v) for v in sides[:, :2].min(0))
        right, bottom = (int(v) for v in sides[:, 2:].max(0))
        return left, top, right, bottom

    def warp(self, name: str, image: Array) -> Layer:
        """A picture of a camera (uint8, of its view's size) on the panorama."""
        picture = cv2.remap(image, self._maps[name], None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        return Layer(self.boxes[name], np.asarray(picture), self.seen[name])

    def warp_mask(self, name: str, mask: Array) -> Array:
        """A mask (bool) of a camera's pixels on the panorama, in the camera's box."""
        warped = cv2.remap(mask.astype(np.uint8), self._maps[name], None, cv2.INTER_NEAREST)
        return np.asarray(warped > 0) & self.seen[name]

    def _box(self, view: View) -> Box:
        flat = _flat_view(view)
        x, y, width, height = self._warper.warpRoi((flat.width, flat.height), *_for_warper(flat))
        return int(x), int(y), int(x + width), int(y + height)

    def _map(self, view: View) -> Array:
        """Pixels of the picture, float32 (height, width, 2), for each pixel of its box."""
        flat = _flat_view(view)
        _, xs, ys = self._warper.buildMaps((flat.width, flat.height), *_for_warper(flat))
        at = np.dstack([np.asarray(xs), np.asarray(ys)])
        if not view.distortion.any():
            return at
        inside = _inside(at, flat)
        spread = (at[inside] - flat.matrix[:2, 2]) / (flat.matrix[0, 0], flat.matrix[1, 1])
        bent = np.full_like(at, -1e4)
        bent[inside] = view.project(np.column_stack([spread, np.ones(len(spread))]))
        return bent

    def _refuse_misfit(self) -> None:
        left, top, right, bottom = self.canvas
        width, height = right - left, bottom - top
        least = min(min(view.width, view.height) for view in self._views.values()) // 2
        area = sum(view.width * view.height for view in self._views.values())
        if min(width, height) < least or width * height > MAX_GROWTH * area:
            raise ValueError(f"the pictures do not fit together: a panorama of {width}x{height} pixels")


def _steepest(view: View) -> float:
    """Tangent of the highest or lowest direction of a picture's edge."""
    rays = view.rays(view.border()) @ view.rotation
    return float((np.abs(rays[:, 1]) / np.maximum(np.hypot(rays[:, 0], rays[:, 2]), 1e-6)).max())


def _flat_view(view: View) -> View:
    """The view without distortion, as large as it takes to hold the whole picture."""
    if not view.distortion.any():
        return view
    focal = np.array([view.matrix[0, 0], view.matrix[1, 1]])
    edge = view.rays(view.border())[:, :2] * focal
    size = np.array([view.width, view.height])
    low, high = np.maximum(edge.min(0), -MAX_WIDENING * size), np.minimum(edge.max(0), MAX_WIDENING * size)
    width, height = (int(n) for n in np.ceil(high - low) + 1)
    matrix = np.diag([*focal, 1.0])
    matrix[:2, 2] = -low
    return replace(view, width=width, height=height, matrix=matrix, distortion=np.zeros(5))


def _for_warper(view: View) -> tuple[Array, Array]:
    """Intrinsics and panorama-from-camera rotation as OpenCV's warpers take them."""
    return view.matrix.astype(np.float32), np.ascontiguousarray(view.rotation.T, np.float32)


def _inside(at: Array, view: View) -> Array:
    """Whether pixels (..., 2) lie in a view's picture (bool)."""
    return np.asarray(((at > -0.5) & (at < (view.width - 0.5, view.height - 0.5))).all(-1))


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
