"""Rectification of a pair: both views rotated so that a point lies in the same row of both."""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from reconstruction.common.geometry import Array, View
from reconstruction.pairs.pair_geometry import canvas_bounds, rectifying_rotations


@dataclass(frozen=True)
class Rectification:
    """A pair rotated onto one common image plane, whose rows run along the baseline.

    A point at depth z (in the rectified frame, calibration's unit) lies `focal * baseline / z` px
    further left in the other view than in the reference. Where the other camera stands on the far side,
    both images are mirrored (`mirror`), so that this always holds with a positive sign. `left` and `top`
    are the coordinates of the canvas's first pixel relative to the common principal point.
    """

    reference: View
    other: View
    reference_rotation: Array
    other_rotation: Array
    focal: float
    baseline: float
    left: float
    top: float
    width: int
    height: int
    mirror: bool

    def remap(self, image: Array, *, other: bool = False, nearest: bool = False) -> tuple[Array, Array]:
        """The image on the canvas, and where the canvas sees it (bool)."""
        xs, ys, seen = self._other_canvas if other else self._reference_canvas
        how = cv2.INTER_NEAREST if nearest else cv2.INTER_LINEAR
        # What lies outside continues the edge: windows that reach out match better than with a black frame.
        return cv2.remap(image, xs, ys, how, borderMode=cv2.BORDER_REPLICATE), seen

    def project(self, rays: Array, *, other: bool = False) -> Array:
        """Canvas pixels (n, 2) of directions (n, 3) in one of the two camera frames."""
        turned = rays @ (self.other_rotation if other else self.reference_rotation).T
        projection = self._projection()
        flat = turned[:, :2] / turned[:, 2:]
        return np.asarray(flat * np.diagonal(projection)[:2] + projection[:2, 2])

    def depth(self, disparity: Array) -> Array:
        """Depth in the reference view's pixels (height x width, 0 = none) from the canvas's disparity."""
        shift = self.to_reference(disparity.astype(np.float32))
        near = shift > 0
        rectified = np.where(near, self.focal * self.baseline / np.where(near, shift, 1.0), 0.0)
        return np.asarray(rectified / self._reference_pixels[2], np.float32)

    def to_reference(self, canvas: Array) -> Array:
        """A canvas's values (nearest) in the reference view's pixels; 0 where the canvas does not reach."""
        xs, ys, _ = self._reference_pixels
        return np.asarray(cv2.remap(canvas, xs, ys, cv2.INTER_NEAREST, borderValue=(0.0,)))

    @cached_property
    def _reference_canvas(self) -> tuple[Array, Array, Array]:
        return self._canvas(self.reference, self.reference_rotation, other=False)

    @cached_property
    def _other_canvas(self) -> tuple[Array, Array, Array]:
        return self._canvas(self.other, self.other_rotation, other=True)

    def _canvas(self, view: View, turn: Array, *, other: bool) -> tuple[Array, Array, Array]:
        """A view's pixel for each of the canvas's (x, y: float32), and where the canvas sees it (bool)."""
        size = (self.width, self.height)
        xs, ys = cv2.initUndistortRectifyMap(
            view.matrix, view.distortion, turn, self._projection(), size, cv2.CV_32FC1
        )
        outline = self.project(view.rays(view.border()), other=other)
        seen = np.zeros((self.height, self.width), np.uint8)
        cv2.fillPoly(seen, [np.round(outline).astype(np.int32)], 1)
        return xs, ys, cv2.erode(seen, np.ones((3, 3), np.uint8)) > 0

    @cached_property
    def _reference_pixels(self) -> tuple[Array, Array, Array]:
        """The canvas's pixel for each of the reference's (x, y), and its ray's z on the canvas; float32."""
        view = self.reference
        pixels = view.grid().astype(np.float32).reshape(-1, 1, 2)
        where = cv2.undistortPoints(
            pixels, view.matrix, view.distortion, R=self.reference_rotation, P=self._projection()
        )
        xs, ys = np.ascontiguousarray(where.reshape(view.height, view.width, 2).transpose(2, 0, 1))
        # With z = 1 on the canvas, the ray's z in the view's own frame is linear in the canvas's pixels.
        right, down, ahead = (float(value) for value in self.reference_rotation[:, 2])
        across = right / (-self.focal if self.mirror else self.focal)
        own = across * (xs + np.float32(self.left)) + down / self.focal * (ys + np.float32(self.top)) + ahead
        return xs, ys, 1 / own

    def _projection(self) -> Array:
        sign = -1.0 if self.mirror else 1.0
        return np.array([[sign * self.focal, 0, -self.left], [0, self.focal, -self.top], [0, 0, 1.0]])


def rectify(
    reference: View, other: View, disparities: tuple[float, float], scale: float = 1.0
) -> Rectification:
    """The pair's rectification, wide enough for these disparities (least, greatest; px at scale 1).

    The canvas holds all of the reference view and, beside it, what its matches in the other need;
    `scale` makes it smaller or larger than the reference's own resolution.

    Raises:
        ValueError: the two cannot be rectified, as `canvas_bounds` says.
    """
    low, high = canvas_bounds(reference, other)
    reference_rotation, other_rotation, length, mirror = rectifying_rotations(reference, other)
    if mirror:
        low, high = np.array([-high[0], low[1]]), np.array([-low[0], high[1]])
    low, high = low * scale, high * scale
    left = np.floor(low[0] - max(disparities[1] * scale, 0.0)) - 1
    right = np.ceil(high[0] - min(disparities[0] * scale, 0.0)) + 1
    top, bottom = np.floor(low[1]) - 1, np.ceil(high[1]) + 1
    return Rectification(
        reference,
        other,
        reference_rotation,
        other_rotation,
        focal=reference.focal * scale,
        baseline=length,
        left=float(left),
        top=float(top),
        width=int(right - left) + 1,
        height=int(bottom - top) + 1,
        mirror=mirror,
    )
