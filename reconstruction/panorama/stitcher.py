"""Stitching engine: images are registered once, then projected and composed in any condition."""

from collections.abc import Mapping

import cv2
import numpy as np

from reconstruction.common.geometry import Array, View, resize_view
from reconstruction.common.memory import memory_budget
from reconstruction.pairs import Features, detect_features
from reconstruction.panorama.composition import Layer, Projection, compose_layers
from reconstruction.panorama.registration import register_pictures

MAX_SIDE_PX = 2000
"""Image size limit; panoramas of full camera images take minutes."""
BYTES_PER_PIXEL = 70
"""Memory per image pixel: maps and layer, both doubled during blending, and the canvas."""


class PanoramaStitcher:
    """Images registered by the still scene; `used` are included, `left_out` holds reasons for the others.

    The methods take images of the same cameras and sizes, of this or another condition.
    """

    def __init__(
        self,
        images: Mapping[str, Array],
        moving: Mapping[str, Array] | None = None,
        known: Mapping[str, View] | None = None,
    ) -> None:
        """Register BGR images by features outside of their `moving` (bool); `known` are calibrated views.

        Raises:
            ValueError: the images cannot be stitched.
        """
        if len(images) < 2:
            raise ValueError("a panorama takes two pictures or more")
        self._sizes = self._fit_sizes({name: image.shape[1::-1] for name, image in images.items()})
        views = {name: resize_view(view, *self._sizes[name]) for name, view in (known or {}).items()}
        points = {
            name: self._features(
                self._shrink(name, image), self._shrink_mask(name, moving[name]) if moving else None
            )
            for name, image in images.items()
        }
        found, self.left_out = register_pictures(points, self._sizes, views)
        self.used, self.projection = tuple(found), Projection(found)

    def layers(self, images: Mapping[str, Array]) -> dict[str, Layer]:
        """Warp the used ones of the BGR images onto the panorama."""
        return {name: self.projection.warp(name, self._shrink(name, images[name])) for name in self.used}

    def layer_mask(self, name: str, mask: Array) -> Array:
        """Warp a mask (bool) of a camera's image onto the panorama, at its layer's size."""
        return self.projection.warp_mask(name, self._shrink_mask(name, mask))

    def compose(self, layers: Mapping[str, Layer]) -> Array:
        """Compose all layers into the panorama (BGR); its size depends on the registration alone."""
        return compose_layers(list(layers.values()), self.projection.canvas)

    def _fit_sizes(self, sizes: Mapping[str, tuple[int, ...]]) -> dict[str, tuple[int, int]]:
        limited = {name: np.array(size) * min(1.0, MAX_SIDE_PX / max(size)) for name, size in sizes.items()}
        pixels = sum(float(np.prod(size)) for size in limited.values())
        scale = memory_budget().fit_scale(
            f"the panorama of {len(sizes)} pictures", lambda smaller: pixels * smaller**2 * BYTES_PER_PIXEL
        )
        return {
            name: (max(1, round(float(width * scale))), max(1, round(float(height * scale))))
            for name, (width, height) in limited.items()
        }

    def _shrink(self, name: str, image: Array) -> Array:
        size = self._sizes[name]
        if image.shape[1::-1] == size:
            return image
        return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))

    def _shrink_mask(self, name: str, mask: Array) -> Array:
        return (
            np.asarray(cv2.resize(mask.astype(np.uint8), self._sizes[name], interpolation=cv2.INTER_NEAREST))
            > 0
        )

    @staticmethod
    def _features(image: Array, moving: Array | None) -> Features:
        found = detect_features(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))
        return found if moving is None else found.at_rest(moving)
