"""Lenses of two models: pixels and rays, points from several cameras, and images redrawn for another lens."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture_app.session.format.calibration import TERMS, CameraCalibration

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]
Redraw = Callable[[Picture], Picture]
"""Function that redraws a camera's image (BGR) as seen by another lens."""
Maps = tuple[NDArray[np.float32], NDArray[np.float32]]
"""x and y of the pixel that each pixel of an image shows, for OpenCV's `remap`."""
_STEPS = 30
_GRID = 60
_WIDEST = float(np.radians(87.0))
"""Maximum angle off the axis at which a fisheye has rays, which are x / z and y / z."""
_BEFORE_FOLD = 0.98
"""Fraction of the radius at which a lens folds up to which it is used: near the fold, rays are unstable."""
_TANGENTIAL_STEPS = 10
OUTSIDE = -10.0
"""Pixel that no image has."""
_TINY = 1e-12


@dataclass(frozen=True, eq=False)
class Lens:
    """OpenCV's perspective lens (k1, k2, p1, p2, k3) or its equidistant fisheye (k1, k2, k3, k4).

    `matrix` is 3x3 in px; the first pixel's centre is (0, 0). Rays are x / z and y / z in the camera's frame.
    Beyond the radius up to which the model is one-to-one, pixels have no ray: they are unknown.
    """

    matrix: Array
    distortion: Array
    is_fisheye: bool = False

    @property
    def is_straight(self) -> bool:
        """Whether straight lines are straight in its images."""
        return not self.is_fisheye and not self.distortion.any()

    @cached_property
    def limit(self) -> tuple[float, float]:
        """The largest one-to-one radius: of rays (x / z), and of pixels about the centre in focal lengths."""
        if not np.isfinite(self._slopes).all():
            return 0.0, 0.0
        squares = np.roots(self._slopes).astype(complex)
        folds = _BEFORE_FOLD * np.sqrt(squares.real[(np.abs(squares.imag) < 1e-9) & (squares.real > 0)])
        if np.isinf(at := float(min([*folds, _WIDEST if self.is_fisheye else np.inf]))):
            return np.inf, np.inf
        if self.is_fisheye:
            return float(np.tan(at)), float(self._bend(at))
        # Tangential terms move the pixels of this radius by up to three times their size.
        return at, float(self._bend(at) - 3 * np.hypot(*self.distortion[2:4]) * at * at)

    @property
    def limit_deg(self) -> float:
        """The angle off the axis up to which it is one-to-one, degrees; 90 if it never folds."""
        return float(np.degrees(np.arctan(self.limit[0])))

    def project(self, rays: Array) -> Array:
        """Return the pixels (n, 2) of rays (n, 2); beyond the limit the model is continued straight."""
        radius = np.hypot(rays[:, 0], rays[:, 1]).clip(_TINY)
        known = np.minimum(radius, self.limit[0])
        inner = rays * (known / radius)[:, None]
        bent = self._bend(np.arctan(known) if self.is_fisheye else known)
        flat = inner * (bent / known)[:, None] + self._tangential(inner) + (rays - inner)
        return np.asarray(flat * self.matrix[[0, 1], [0, 1]] + self.matrix[:2, 2])

    def rays(self, pixels: ArrayLike) -> Array:
        """Return the rays (n, 2) of pixels (n, 2); of unknown pixels the nearest ray of a known one."""
        flat = self._flat(np.asarray(pixels, np.float64).reshape(-1, 2))
        if self.is_straight or not len(flat):
            return flat
        radius = np.hypot(flat[:, 0], flat[:, 1]).clip(_TINY)
        flat = flat * np.minimum(1.0, self.limit[1] / radius)[:, None]
        end = np.arctan(self.limit[0]) if self.is_fisheye else min(1.0, self.limit[0])
        while np.isinf(self.limit[0]) and self._bend(end) < 2 * radius.max():
            end *= 2
        table, shift = np.linspace(0.0, end, 2000), np.zeros_like(flat)
        for _ in range(_TANGENTIAL_STEPS if self._tangential(flat).any() else 1):
            bent = flat - shift
            radius = np.hypot(bent[:, 0], bent[:, 1]).clip(_TINY)
            at = np.interp(radius, self._bend(table), table)
            for _ in range(4):
                at = at - (self._bend(at) - radius) / np.polyval(self._slopes, at * at)
            rays = bent * ((np.tan(at) if self.is_fisheye else at) / radius)[:, None]
            shift = self._tangential(rays)
        return np.asarray(rays)

    def field_deg(self, width: int) -> float:
        """Return the horizontal field of view, degrees, of an image of this width, or to where it folds."""
        angles = np.linspace(0, np.radians(110.0 if self.is_fisheye else 89.9), 5000)
        radii = np.maximum.accumulate(self._bend(angles if self.is_fisheye else np.tan(angles)))
        edges = np.abs(np.array([-0.5, width - 0.5]) - self.matrix[0, 2]) / self.matrix[0, 0]
        return float(np.degrees(np.interp(edges, radii, angles, right=angles[radii.argmax()]).sum()))

    def known(self, pixels: Array) -> NDArray[np.bool_]:
        """Return which pixels (n, 2) have a ray."""
        return np.asarray(np.linalg.norm(self._flat(pixels), axis=1) <= self.limit[1] * (1 + 1e-9))

    def undistort(self, image: Picture) -> Picture:
        """Return an image without distortion, with the same camera matrix and size."""
        import cv2

        if self.is_straight:
            return image
        maps = self.maps((image.shape[1], image.shape[0]), self.matrix)
        return np.asarray(cv2.remap(image, *maps, cv2.INTER_LINEAR), np.uint8)

    def maps(self, size: tuple[int, int], matrix: Array, rotation: Array | None = None) -> Maps:
        """Return, for the pixels of a straight lens, this lens's pixel; outside its image if it is unknown.

        `size` (width, height) and `matrix` are the straight lens's, `rotation` turns this lens's rays into
        its.
        """
        import cv2

        turned = np.eye(3) if rotation is None else rotation
        if not self.is_fisheye:
            lens = self.matrix, self.distortion
            maps = cv2.initUndistortRectifyMap(*lens, turned, matrix, size, cv2.CV_32FC1)
            if np.isinf(self.limit[0]):
                return maps
        # A rectified pair may be mirrored: only the inverse of the product is a ray.
        to_ray = np.linalg.inv(matrix @ turned)
        columns, rows = np.arange(size[0]), np.arange(size[1])[:, None]
        x, y, z = (row[0] * columns + (row[1] * rows + row[2]) for row in to_ray)
        if self.is_fisheye:
            z[z <= 0] = np.nan
            return self.maps_of_rays(np.column_stack([(x / z).ravel(), (y / z).ravel()]), size)
        unknown = (z <= 0) | (np.hypot(x, y) > self.limit[0] * z)
        for axis in maps:
            axis[unknown] = OUTSIDE
        return maps

    def maps_of_rays(self, rays: Array, size: tuple[int, int]) -> Maps:
        """Return the pixels of rays, one for each pixel of an image of this size, as `maps` does."""
        pixels = self.project(rays).astype(np.float32)
        pixels[~(np.hypot(rays[:, 0], rays[:, 1]) <= self.limit[0])] = OUTSIDE
        xs, ys = np.ascontiguousarray(pixels.T).reshape(2, size[1], size[0])
        return xs, ys

    @cached_property
    def _terms(self) -> Array:
        """Radial terms, of the highest power of the squared radius first."""
        return np.array([1.0, *(self.distortion if self.is_fisheye else self.distortion[[0, 1, 4]])])[::-1]

    @cached_property
    def _slopes(self) -> Array:
        """Terms of the derivative of `_bend`."""
        return np.asarray(self._terms * np.arange(2 * len(self._terms) - 1, 0, -2))

    def _bend(self, radius: Array | float) -> Array:
        """Return the radius of pixels by the rays' radius: of x / z, for a fisheye of the angle (radians)."""
        return np.asarray(np.polyval(self._terms, np.square(radius)) * radius)

    def _tangential(self, rays: Array) -> Array:
        """Return the shift of the pixels (n, 2) of rays by tangential terms, in focal lengths."""
        p = np.zeros(2) if self.is_fisheye else self.distortion[[3, 2]]
        return np.asarray((rays**2).sum(1, keepdims=True) * p + 2 * rays * (rays @ p)[:, None])

    def _flat(self, pixels: Array) -> Array:
        """Return pixels (n, 2) about the centre, in focal lengths."""
        return np.asarray((pixels - self.matrix[:2, 2]) / self.matrix[[0, 1], [0, 1]])


def rotation_of(camera: CameraCalibration) -> Array:
    """Return the rotation of `cam_from_rig`, 3x3."""
    return np.array(camera.rotation, np.float64)


def translation_of(camera: CameraCalibration) -> Array:
    """Return the translation of `cam_from_rig`, (3,), in the calibration's unit."""
    return np.array(camera.translation, np.float64)


def centre_of(camera: CameraCalibration) -> Array:
    """Return the camera's position in rig coordinates, (3,), in the calibration's unit."""
    return np.asarray(-rotation_of(camera).T @ translation_of(camera))


def matrix_of(camera: CameraCalibration) -> Array:
    """Return OpenCV's camera matrix, 3x3, in px; the first pixel's centre is (0, 0)."""
    return np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]], np.float64)


def distortion_of(camera: CameraCalibration) -> Array:
    """Return OpenCV's k1, k2, p1, p2, k3; of a fisheye its k1, k2, k3, k4."""
    return np.array([*camera.distortion, *[0.0] * 5][: len(TERMS[camera.is_fisheye])], np.float64)


def lens_of(camera: CameraCalibration) -> Lens:
    """Return a camera's lens, at the size of its calibration."""
    return Lens(matrix_of(camera), distortion_of(camera), camera.is_fisheye)


def triangulate_rays(seen: Iterable[tuple[Array, Array]]) -> Array:
    """Return homogeneous points (n, 4) in the rig's frame from what each camera sees of them.

    Each camera gives its rays, x / z and y / z (n, 2), and its `cam_from_rig` (3, 4). A point minimizes the
    algebraic error over all cameras (DLT: Hartley and Zisserman, 12.2).
    """
    system = np.concatenate([rays[:, :, None] * pose[2] - pose[:2] for rays, pose in seen], axis=1)
    system /= np.linalg.norm(system, axis=2, keepdims=True).clip(1e-12)
    return np.asarray(np.linalg.svd(system)[2][:, -1])


def nearest_point(centres: Array, directions: Array, max_condition: float) -> Array | None:
    """Return the point (3,) with the least squared distances from lines; None if they are nearly parallel.

    The lines go through `centres` (n, 3) along `directions` (n, 3; unit length). They are nearly parallel if
    the condition number of the equations is over `max_condition`.
    """
    across = np.eye(3) - directions[:, :, None] * directions[:, None]
    system = across.sum(axis=0)
    if np.linalg.cond(system) > max_condition:
        return None
    return np.asarray(np.linalg.solve(system, np.einsum("nij,nj->i", across, centres)))


def quaternion(rotation: Array) -> tuple[float, float, float, float]:
    """Return the unit quaternion (w, x, y, z), w >= 0, of a rotation matrix (Horn 1987, section 4)."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rotation
    symmetric = np.array(
        [
            [xx + yy + zz, zy - yz, xz - zx, yx - xy],
            [zy - yz, xx - yy - zz, xy + yx, xz + zx],
            [xz - zx, xy + yx, yy - xx - zz, yz + zy],
            [yx - xy, xz + zx, yz + zy, zz - xx - yy],
        ]
    )
    w, x, y, z = map(float, np.linalg.eigh(symmetric).eigenvectors[:, -1])
    return (w, x, y, z) if w >= 0 else (-w, -x, -y, -z)


def rodrigues(rotation: Array) -> list[float]:
    """Return the rotation vector in radians of a rotation matrix."""
    import cv2

    return [float(value) for value in cv2.Rodrigues(rotation)[0].ravel()]


def rays_of(camera: CameraCalibration, pixels: Array) -> Array:
    """Return the rays (n, 2) of pixels (n, 2); NaN where the lens model has none."""
    lens = lens_of(camera)
    return np.where(lens.known(pixels)[:, None], lens.rays(pixels), np.nan)


def picture_rays(camera: CameraCalibration) -> Array:
    """Return the rays (n, 2) of a grid over the whole image, edge to edge, for pixels that have one."""
    columns, rows = np.meshgrid(
        np.linspace(-0.5, camera.width - 0.5, _GRID), np.linspace(-0.5, camera.height - 0.5, _GRID)
    )
    rays = rays_of(camera, np.stack([columns.ravel(), rows.ravel()], axis=1))
    return np.asarray(rays[~np.isnan(rays).any(axis=1)])


def without_k3(camera: CameraCalibration) -> tuple[CameraCalibration, float]:
    """Fit the closest lens with only k1, k2, p1 and p2 over the whole image.

    Returns it, with its own focal lengths and principal point, and the largest distance in px between the
    pixels to which both lenses map the same ray (least squares over a grid, Gauss-Newton).
    """
    if not distortion_of(camera)[4]:
        return camera, 0.0
    rays = picture_rays(camera)
    seen = lens_of(camera).project(rays)
    fitted = msgspec.structs.replace(camera, distortion=(*map(float, distortion_of(camera)[:4]), 0.0))
    for _ in range(_STEPS):
        slopes = _slopes(fitted, rays)
        scale = np.linalg.norm(slopes, axis=0)
        step = np.linalg.lstsq(slopes / scale, (seen - lens_of(fitted).project(rays)).ravel())[0] / scale
        fx, fy, cx, cy, *given = (np.array(_parameters(fitted)) + step).tolist()
        fitted = msgspec.structs.replace(fitted, fx=fx, fy=fy, cx=cx, cy=cy, distortion=(*given, 0.0))
        if np.abs(step[:4]).max() < 1e-9:
            break
    worst = float(np.linalg.norm(seen - lens_of(fitted).project(rays), axis=1).max())
    if not worst < max(camera.width, camera.height) or min(fitted.fx, fitted.fy) <= 0:
        # The fit failed: then images are redrawn without any distortion instead.
        fitted = msgspec.structs.replace(camera, distortion=(0.0,) * 5)
        worst = float(np.linalg.norm(seen - lens_of(fitted).project(rays), axis=1).max())
    return fitted, worst


def redrawing(camera: CameraCalibration, target: CameraCalibration) -> Redraw | None:
    """Return a function that redraws a camera's images for the lens `target`; None if the lenses are equal.

    The pose stays the same. Pixels are interpolated bilinearly; what the camera did not see is black.
    """
    import cv2

    size = (target.width, target.height)
    lenses = [(lens.width, lens.height, lens.model, _parameters(lens)) for lens in (camera, target)]
    if lenses[0] == lenses[1]:
        return None
    if lens_of(target).is_straight:
        maps = lens_of(camera).maps(size, matrix_of(target))
    else:
        rows, columns = np.mgrid[: target.height, : target.width].astype(np.float64)
        rays = rays_of(target, np.stack([columns.ravel(), rows.ravel()], axis=1))
        maps = lens_of(camera).maps_of_rays(rays, size)
    for axis, length in zip(maps, (camera.width, camera.height), strict=True):
        # The image extends half a pixel beyond its outermost pixel centres.
        np.clip(axis, 0, length - 1, out=axis, where=(axis >= -0.51) & (axis <= length - 0.49))

    def redraw(picture: Picture) -> Picture:
        # OpenCV's bicubic kernel (a = -0.75) does not preserve a ramp: it shifts a smooth dot by up to 0.06
        # px. It redraws four channels in half the time of three.
        four = cv2.remap(cv2.cvtColor(picture, cv2.COLOR_BGR2BGRA), *maps, cv2.INTER_LINEAR)
        return np.asarray(cv2.cvtColor(four, cv2.COLOR_BGRA2BGR), np.uint8)

    return redraw


def _parameters(camera: CameraCalibration) -> tuple[float, ...]:
    given = distortion_of(camera)
    terms = given if camera.is_fisheye or given[4] else given[:4]
    return (camera.fx, camera.fy, camera.cx, camera.cy, *map(float, terms))


def _slopes(camera: CameraCalibration, rays: Array) -> Array:
    """Return derivatives (2n, 8) of a perspective lens's pixels by fx, fy, cx, cy, k1, k2, p1 and p2."""
    import cv2

    points, none = np.column_stack([rays, np.ones(len(rays))]), np.zeros(3)
    _, slopes = cv2.projectPoints(points, none, none, matrix_of(camera), distortion_of(camera))
    return np.asarray(slopes)[:, 6:14]
