"""Calibrated grey images, and source images warped onto them and compared by windows."""

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np

from reconstruction.common.geometry import Array, View, other_from_reference, resize_view
from reconstruction.common.image_matching import noise_level

NOISY = 1.25
"""A window contains only noise if its variance is below this multiple of the noise term."""
BLACK, WHITE = 20, 245
"""Grey levels (of 255) below and above which an image shows no detail."""
OUTSIDE = -1000.0
"""Grey level of areas outside a view; a window that touches them has a negative mean."""


@dataclass(frozen=True, eq=False)
class CalibratedImage:
    """Undistorted image of a view: `grey` float32 height x width, and the side of its matching window."""

    view: View
    grey: Array
    window: int
    noise: float
    """Variance that noise alone adds to a window, grey levels squared."""
    moving: Array | None = None
    """Moving pixels (bool), which are not walls, at the image's size; None if unknown."""
    colours: Array | None = None
    """Colours (uint8 height x width x 3), which tell surfaces apart; None if only grey is known."""

    def scaled(self, scale: float) -> "CalibratedImage":
        """Return the image scaled by `scale` (at most 1)."""
        if scale >= 1.0:
            return self
        view = self.view
        width, height = round(view.width * scale), round(view.height * scale)
        grey = cv2.resize(self.grey, (width, height), interpolation=cv2.INTER_AREA)
        return replace(self, view=resize_view(view, width, height), grey=grey, moving=None, colours=None)

    def cropped(self, box: tuple[slice, slice]) -> "CalibratedImage":
        """Return the image cropped to a box of rows and columns, for matching only."""
        grey = np.ascontiguousarray(self.grey[box])
        if grey.shape == self.grey.shape:
            return self
        matrix = self.view.matrix.copy()
        matrix[:2, 2] -= box[1].start or 0, box[0].start or 0
        view = replace(self.view, width=grey.shape[1], height=grey.shape[0], matrix=matrix)
        return replace(self, view=view, grey=grey, moving=None, colours=None)

    @cached_property
    def mean(self) -> Array:
        """Mean of each pixel's window."""
        return box_filter(self.grey, self.window)

    @cached_property
    def deviation(self) -> Array:
        """Standard deviation of each pixel's window, including noise, so that flat windows do not match."""
        variance = box_filter(self.grey * self.grey, self.window) - self.mean**2
        return np.asarray(np.sqrt(np.maximum(variance, 0) + self.noise))

    @cached_property
    def bordered(self) -> Array:
        """The grey levels with a border of `OUTSIDE`: one pixel left and above, two right and below."""
        return np.asarray(cv2.copyMakeBorder(self.grey, 1, 2, 1, 2, cv2.BORDER_CONSTANT, value=(OUTSIDE,)))

    @property
    def coloured(self) -> Array:
        """The colours, or grey ones where there are none (uint8 height x width x 3)."""
        if self.colours is not None:
            return self.colours
        return np.repeat(self.grey[..., None].clip(0, 255).astype(np.uint8), 3, axis=2)

    @property
    def blank(self) -> Array:
        """Pixels whose window contains only noise, and is black or burnt out (bool)."""
        # `noise` is (3 sigma)^2 and part of `deviation`^2: a quarter of it is (1.5 sigma)^2.
        plain = self.deviation**2 < NOISY * self.noise
        return np.asarray(plain & ((self.mean < BLACK) | (self.mean > WHITE)))

    @property
    def flat(self) -> Array:
        """Static pixels whose window contains only noise (bool)."""
        flat = self.deviation**2 < NOISY * self.noise
        return np.asarray(flat if self.moving is None else flat & ~self.moving)

    @cached_property
    def rays(self) -> Array:
        """Directions (3, height, width) with z = 1, float32."""
        ys, xs = np.mgrid[0 : self.view.height, 0 : self.view.width].astype(np.float32)
        inverse = np.linalg.inv(self.view.matrix).astype(np.float32)
        x, y = inverse[0, 0] * xs + inverse[0, 2], inverse[1, 1] * ys + inverse[1, 2]
        return np.stack([x, y, np.ones_like(xs)])

    def surface_normals(self, inverse_depth: Array, right: Array, down: Array) -> Array:
        """Return unit normals (height x width x 3, float32) in the camera's frame, facing the camera.

        `right`, `down`: slope per pixel. With w = a + right * x + down * y and rays (x', y', 1) of the
        pixels, the plane n . X = d has n / d = gradient of w along the rays.
        """
        per_x, per_y = right * np.float32(self.view.matrix[0, 0]), down * np.float32(self.view.matrix[1, 1])
        parts = per_x, per_y, inverse_depth - per_x * self.rays[0] - per_y * self.rays[1]
        scale = -1 / np.maximum(np.sqrt(sum(part * part for part in parts)), 1e-12)
        return np.stack([part * scale for part in parts], axis=-1)


def matching_noise(grey: Array) -> float:
    """Return the variance that an image's noise adds to a window: three sigma, within limits, squared."""
    return float(np.clip((3.0 * noise_level(grey)) ** 2, 2.0, 100.0))


def box_filter(image: Array, window: int) -> Array:
    """Return the mean over a square window, mirrored at the borders."""
    return np.asarray(cv2.boxFilter(image, -1, (window, window), borderType=cv2.BORDER_REFLECT_101))


class SourceView:
    """Mapping from a reference view to a source view, through planes of constant depth or a depth map."""

    def __init__(self, reference: CalibratedImage, source: CalibratedImage) -> None:
        self.reference = reference
        self.source = source
        rotation, translation = other_from_reference(reference.view, source.view)
        self.rotation, self.translation = rotation, translation
        self.at_infinity = source.view.matrix @ rotation @ np.linalg.inv(reference.view.matrix)
        """Homography (3x3) from reference to source pixels for points at infinity."""
        self.shift = source.view.matrix @ translation
        """Change of a source pixel's homogeneous coordinates with inverse depth (3,)."""

    @property
    def numbers(self) -> Array:
        """Coefficients (13,) of the map from reference pixel and inverse depth to source; its noise last."""
        return np.concatenate([self.at_infinity.reshape(-1), self.shift, [self.source.noise]])

    def project(self, inverse_depth: Array, every: int = 1) -> tuple[Array, Array, Array]:
        """Project the reference's pixels at these inverse depths to source x, y, and z times inverse depth.

        Uses every `every`-th row and column. x and y are NaN behind the source.
        """
        height, width = self.reference.grey.shape
        ys, xs = (axis.astype(np.float32) for axis in np.ogrid[:height:every, :width:every])
        matrix = np.column_stack([self.at_infinity, self.shift]).astype(np.float32)
        x, y, z = (a * xs + b * ys + c + d * inverse_depth for a, b, c, d in matrix)
        far = 1.0 / np.where(z > 1e-6, z, np.float32(np.nan))
        return x * far, y * far, z
