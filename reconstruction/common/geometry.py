"""Calibrated views: mapping between pixels and rays."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
import numpy.typing as npt
from msgspec import UNSET, UnsetType

from capture_app.session.format.calibration import CameraCalibration
from capture_app.session.format.lens import Lens, lens_of

Array = npt.NDArray[Any]
"""An array; its type and shape are in the docstring of what uses it."""
SIGMAS_95 = 1.96
"""Standard deviations of a 95 % error."""


@dataclass(frozen=True)
class View:
    """Intrinsics (px, first pixel's centre at 0, 0) and `cam_from_rig` of one camera.

    `matrix` 3x3, `distortion` after OpenCV ((5,), of a fisheye (4,)), `rotation` 3x3 and `translation` (3,)
    in the calibration's unit. `seen_deg`: as in `CameraCalibration`.
    """

    width: int
    height: int
    matrix: Array
    distortion: Array
    rotation: Array
    translation: Array
    is_fisheye: bool = False
    seen_deg: float | UnsetType = UNSET

    @classmethod
    def from_calibration(cls, camera: CameraCalibration, width: int, height: int) -> Self:
        """Return the view of a camera for images of width x height px, scaled from its calibration's size."""
        lens = replace(lens_of(camera), matrix=camera.matrix(width, height))
        pose = np.array(camera.rotation), np.array(camera.translation)
        return replace(cls.from_lens(lens, (width, height), *pose), seen_deg=camera.seen_deg)

    @classmethod
    def from_lens(cls, lens: Lens, size: tuple[int, int], rotation: Array, translation: Array) -> Self:
        """Return the view of a lens with images of this size (px) at a pose."""
        return cls(*size, lens.matrix, lens.distortion, rotation, translation, lens.is_fisheye)

    @cached_property
    def lens(self) -> Lens:
        """The view's lens."""
        return Lens(self.matrix, self.distortion, self.is_fisheye)

    def to_calibration(self) -> CameraCalibration:
        """Return the view in the form that a session's calibration stores."""
        m = self.matrix
        return CameraCalibration(
            width=self.width,
            height=self.height,
            fx=float(m[0, 0]),
            fy=float(m[1, 1]),
            cx=float(m[0, 2]),
            cy=float(m[1, 2]),
            rotation=tuple(tuple(float(v) for v in row) for row in self.rotation),  # type: ignore[arg-type]
            translation=tuple(float(v) for v in self.translation),  # type: ignore[arg-type]
            distortion=tuple(float(v) for v in self.distortion),
            model="fisheye" if self.is_fisheye else UNSET,
            seen_deg=self.seen_deg,
        )

    @property
    def projection(self) -> Array:
        """The matrix (3, 4) that projects rig points to pixels without distortion."""
        return np.asarray(self.matrix @ np.column_stack([self.rotation, self.translation]))

    @property
    def undistorted(self) -> Self:
        """The same view without lens distortion, as undistorted images have it."""
        return replace(self, distortion=np.zeros(5), is_fisheye=False)

    def magnified(self, factor: float) -> Self:
        """Return the same view with focal lengths that are longer by a factor."""
        return replace(self, matrix=self.matrix * [[factor, 1, 1], [1, factor, 1], [1, 1, 1]])

    def undistort_image(self, image: Array) -> Array:
        """Return an image of this view as `undistorted` sees it; the image itself without distortion."""
        return self.lens.undistort(image)

    @property
    def centre(self) -> Array:
        """The camera's position in the rig, (3,)."""
        return np.asarray(-self.rotation.T @ self.translation)

    @property
    def axis(self) -> Array:
        """The viewing direction in the rig, a unit vector (3,)."""
        return np.asarray(self.rotation[2])

    @property
    def focal(self) -> float:
        """Mean focal length, px."""
        return float(self.matrix[0, 0] + self.matrix[1, 1]) / 2

    def rays(self, pixels: Array) -> Array:
        """Return the directions (n, 3) with z = 1, in the camera's frame, of distorted pixels (n, 2)."""
        flat = self.lens.rays(pixels)
        return np.column_stack([flat, np.ones(len(flat))])

    def undistort(self, pixels: Array) -> Array:
        """Return pixels (n, 2) without the lens distortion."""
        return np.asarray((self.rays(pixels) @ self.matrix.T)[:, :2])

    def project(self, points: Array) -> Array:
        """Project points (n, 3) in the camera's frame, z > 0, to distorted pixels (n, 2)."""
        if self.lens.is_straight:
            return np.asarray(
                (points @ self.matrix.T)[:, :2] / np.where(points[:, 2:] == 0, 1, points[:, 2:])
            )
        return self.lens.project(points[:, :2] / np.where(points[:, 2:] == 0, 1, points[:, 2:]))

    def unproject(self, pixels: Array, depth: Array) -> Array:
        """Return rig points (n, 3) at depths (n,) along pixels (n, 2) of an undistorted view."""
        rays = np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(self.matrix).T
        return np.asarray((rays * depth[:, None] - self.translation) @ self.rotation)

    def unproject_map(self, depth: Array, where: Array) -> Array:
        """Return rig points (n, 3) of an undistorted view's pixels `where` (bool), at a map's depths."""
        rows, columns = np.nonzero(where)
        return self.unproject(np.column_stack([columns, rows]), depth[rows, columns].astype(float))

    def grid(self) -> Array:
        """Return the coordinates of every pixel of the image, row by row, (height * width, 2)."""
        ys, xs = np.mgrid[0 : self.height, 0 : self.width]
        return np.column_stack([xs.ravel(), ys.ravel()]).astype(np.float64)

    def border(self, steps: int = 32) -> Array:
        """Return pixels around the image's edge, in order, (4 * steps, 2)."""
        s = np.linspace(0.0, 1.0, steps, endpoint=False)
        w, h = self.width - 1.0, self.height - 1.0
        xs = np.concatenate([s * w, 0 * s + w, (1 - s) * w, 0 * s])
        ys = np.concatenate([0 * s, s * h, 0 * s + h, (1 - s) * h])
        return np.column_stack([xs, ys])


def other_from_reference(reference: View, other: View) -> tuple[Array, Array]:
    """Return rotation 3x3 and translation (3,) from the reference view's frame to the other's."""
    rotation = other.rotation @ reference.rotation.T
    return rotation, other.translation - rotation @ reference.translation


def epipolar_errors_px(a: View, b: View, at_a: Array, at_b: Array) -> Array:
    """Return the signed distances (n,) of matched pixels (n, 2) from the epipolar geometry of two views, px.

    To first order (Sampson 1982; Hartley and Zisserman, 2nd edition, section 11.4.3). Zero for views at one
    place, which have no such geometry.
    """
    rotation, translation = other_from_reference(a, b)
    x, y, z = translation / max(1e-12, float(np.linalg.norm(translation)))
    essential = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ rotation
    rays_a, rays_b = a.rays(at_a), b.rays(at_b)
    lines_b, lines_a = rays_a @ essential.T, rays_b @ essential
    steepness = np.sqrt((lines_b[:, :2] ** 2).sum(1) / b.focal**2 + (lines_a[:, :2] ** 2).sum(1) / a.focal**2)
    return np.asarray((rays_b * lines_b).sum(1) / np.maximum(steepness, 1e-12))


def angle_deg(a: Array, b: Array) -> float:
    """Return the angle between two directions, degrees."""
    cosine = float(a @ b) / float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def angles_deg(a: Array, b: Array) -> Array:
    """Return the angles (n,) between corresponding directions (n, 3), degrees."""
    cosine = (a * b).sum(1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1)
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def look_along(ahead: Array, down: Array) -> Array:
    """Return the rotation of an upright camera that looks along a unit vector; `down` is about downwards."""
    right = np.cross(down, ahead)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(ahead, right), ahead])


def resize_view(view: View, width: int, height: int) -> View:
    """Return the view for images of another size."""
    sx, sy = width / view.width, height / view.height
    scale = np.array([[sx, 0, 0.5 * sx - 0.5], [0, sy, 0.5 * sy - 0.5], [0, 0, 1.0]])
    return replace(view, width=width, height=height, matrix=scale @ view.matrix)
