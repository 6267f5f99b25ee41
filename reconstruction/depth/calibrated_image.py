"""A grey picture with its view, and the statistics of the windows it is matched by."""

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np

from reconstruction.common.geometry import Array, View, resize_view


@dataclass(frozen=True, eq=False)
class CalibratedImage:
    """A view's picture without distortion: `grey` float32 height x width, and the window it is matched by."""

    view: View
    grey: Array
    window: int
    noise: float
    """Variance that the noise alone gives a window, grey levels squared."""

    def scaled(self, scale: float) -> "CalibratedImage":
        """The same picture, `scale` (at most 1) times as large."""
        if scale >= 1.0:
            return self
        view = self.view
        width, height = round(view.width * scale), round(view.height * scale)
        grey = cv2.resize(self.grey, (width, height), interpolation=cv2.INTER_AREA)
        return replace(self, view=resize_view(view, width, height), grey=grey)

    @cached_property
    def mean(self) -> Array:
        """Mean of each pixel's window."""
        return box_filter(self.grey, self.window)

    @cached_property
    def deviation(self) -> Array:
        """Standard deviation in each pixel's window, noise included, so that flat windows match nothing."""
        variance = box_filter(self.grey * self.grey, self.window) - self.mean**2
        return np.asarray(np.sqrt(np.maximum(variance, 0) + self.noise))

    @cached_property
    def rays(self) -> Array:
        """Directions (3, height, width) with z = 1, float32."""
        ys, xs = np.mgrid[0 : self.view.height, 0 : self.view.width].astype(np.float32)
        inverse = np.linalg.inv(self.view.matrix).astype(np.float32)
        return np.stack(
            [inverse[0, 0] * xs + inverse[0, 2], inverse[1, 1] * ys + inverse[1, 2], np.ones_like(xs)]
        )


def box_filter(image: Array, window: int) -> Array:
    """Mean over a square window, mirrored at the borders."""
    return np.asarray(cv2.boxFilter(image, -1, (window, window), borderType=cv2.BORDER_REFLECT_101))
