"""Lenses of two models: pixels and rays, points from several cameras, and images redrawn for another lens."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture_app.common.errors import BadInputError
from capture_app.session.format.calibration import CameraCalibration

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]
Redraw = Callable[[Picture], Picture]
"""Function that redraws a camera's image as seen by another lens."""
_STEPS = 30
_FOUND_PX = 1e-6
_GRID = 60
_WIDEST = np.radians(87.0)
"""Maximum angle off the axis at which a fisheye has rays, which are x / z and y / z."""
_BEFORE_FOLD = 0.98
"""Fraction of the radius at which a lens folds up to which it is used: near the fold, rays are unstable."""
_STEEP = 0.8
"""Fraction of that radius beyond which OpenCV's iteration to undistort converges slowly."""
OUTSIDE = -10.0
"""Pixel that no image has."""


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
        terms = self.distortion if self.is_fisheye else self.distortion[[0, 1, 4]]
        widest = float(_WIDEST) if self.is_fisheye else np.inf
        if not np.isfinite(9 * terms).all():
            return 0.0, 0.0
        # The derivative of x + k1 x^3 + k2 x^5 + ... is a polynomial in x squared.
        slope = [(2 * n + 1) * term for n, term in reversed([*enumerate([1.0, *terms])])]
        roots = np.roots(slope)
        folds = [_BEFORE_FOLD * np.sqrt(x.real) for x in roots if abs(x.imag) < 1e-9 and x.real > 0]
        at = float(min([*folds, widest]))
        if not np.isfinite(at):
            return np.inf, np.inf
        if self.is_fisheye:
            return float(np.tan(at)), float(self._bent(np.array(at)))
        # Tangential terms move the pixels of this radius by up to three times their size.
        return at, float(self._bent(np.array(at)) - 3 * np.hypot(*self.distortion[2:4]) * at * at)

    @property
    def limit_deg(self) -> float:
        """The angle off the axis up to which it is one-to-one, degrees; 90 if it never folds."""
        return float(np.degrees(np.arctan(self.limit[0])))

    def project(self, rays: Array) -> Array:
        """Return the pixels (n, 2) of rays (n, 2); beyond the limit the model is continued straight."""
        focal, centre = self.matrix[[0, 1], [0, 1]], self.matrix[:2, 2]
        radius = np.hypot(rays[:, 0], rays[:, 1])
        inner = rays
        if (beyond := radius > self.limit[0]).any():
            inner = rays * np.where(beyond, self.limit[0] / np.maximum(radius, 1e-12), 1.0)[:, None]
        if self.is_fisheye:
            at = np.hypot(inner[:, 0], inner[:, 1])
            scale = self._bent(np.arctan(at)) / np.maximum(at, 1e-12)
            pixels = inner * np.where(at > 1e-9, scale, 1.0)[:, None] * focal + centre
        else:
            pixels = _project_perspective(self.matrix, self.distortion, inner)[0]
        return np.asarray(pixels + (rays - inner) * focal)

    def rays(self, pixels: ArrayLike) -> Array:
        """Return the rays (n, 2) of pixels (n, 2); of unknown pixels the nearest ray of a known one."""
        import cv2

        points = np.asarray(pixels, np.float64).reshape(-1, 2)
        if not len(points):
            return np.zeros((0, 2))  # of no points OpenCV returns one number
        if np.isfinite(self.limit[1]):
            centre = self.matrix[:2, 2]
            points = (
                centre
                + (points - centre)
                * np.minimum(1.0, self.limit[1] / np.maximum(self._radius(points), 1e-12))[:, None]
            )
        steep = self._radius(points) > _STEEP * self.limit[1]
        if self.is_fisheye or steep.all():
            return self._steep_rays(points)
        # OpenCV's default of five steps leaves 30 px of error at the border of a 100 degree lens.
        until = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-8)
        found = cv2.undistortPoints(points.reshape(-1, 1, 2), self.matrix, self.distortion, criteria=until)
        rays = np.asarray(found).reshape(-1, 2)
        if steep.any():
            rays[steep] = self._steep_rays(points[steep])
        return rays

    def known(self, pixels: Array) -> NDArray[np.bool_]:
        """Return which pixels (n, 2) have a ray."""
        return np.asarray(self._radius(pixels) <= self.limit[1] * (1 + 1e-9))

    def maps(
        self, size: tuple[int, int], matrix: Array, rotation: Array | None = None
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return, for the pixels of a straight lens, this lens's pixel (x and y: float32, height x width).

        `size` (width, height) and `matrix` are the straight lens's, `rotation` turns this lens's rays into
        its. What this lens does not know is outside its image.
        """
        import cv2

        turned = np.eye(3) if rotation is None else rotation
        if not self.is_fisheye:
            xs, ys = cv2.initUndistortRectifyMap(
                self.matrix, self.distortion, turned, matrix, size, cv2.CV_32FC1
            )
            if np.isinf(self.limit[0]):
                return xs, ys
        rows, columns = np.mgrid[: size[1], : size[0]]
        flat = np.column_stack([columns.ravel(), rows.ravel(), np.ones(rows.size)])
        # A rectified pair may be mirrored: only the inverse of the product is a ray.
        ahead = flat @ np.linalg.inv(matrix @ turned).T
        with np.errstate(divide="ignore", invalid="ignore"):
            rays = ahead[:, :2] / ahead[:, 2:]
        beyond = ~(np.hypot(rays[:, 0], rays[:, 1]) <= self.limit[0]) | (ahead[:, 2] <= 0)
        if self.is_fisheye:
            rays[beyond] = 0
            xs, ys = self.project(rays).astype(np.float32).T.reshape(2, size[1], size[0])
        xs, ys = np.ascontiguousarray(xs), np.ascontiguousarray(ys)
        xs[beyond.reshape(xs.shape)] = OUTSIDE
        return xs, ys

    def _bent(self, at: Array) -> Array:
        """Return the radius of pixels by that of rays: of x / z, for a fisheye of the angle (radians)."""
        terms = self.distortion if self.is_fisheye else self.distortion[[0, 1, 4]]
        with np.errstate(over="ignore", invalid="ignore"):
            return np.asarray(at * np.polynomial.polynomial.polyval(at * at, [1.0, *terms]))

    def _radius(self, pixels: Array) -> Array:
        flat = (pixels - self.matrix[:2, 2]) / self.matrix[[0, 1], [0, 1]]
        return np.hypot(flat[:, 0], flat[:, 1])

    def _steep_rays(self, pixels: Array) -> Array:
        """Return rays by the inverse of the radial terms, then for tangential ones by Newton's method."""
        flat = (pixels - self.matrix[:2, 2]) / self.matrix[[0, 1], [0, 1]]
        radius = np.hypot(flat[:, 0], flat[:, 1])
        widest = np.arctan(self.limit[0]) if self.is_fisheye else self.limit[0]
        table = np.linspace(0.0, widest, 2000)
        at = np.interp(radius, self._bent(table), table)
        slope = [1.0, *(self.distortion if self.is_fisheye else self.distortion[[0, 1, 4]])]
        slope = [(2 * n + 1) * term for n, term in enumerate(slope)]
        for _ in range(4):
            at = at - (self._bent(at) - radius) / np.polynomial.polynomial.polyval(at * at, slope)
        ahead = np.tan(at) if self.is_fisheye else at
        rays = flat * np.where(radius > 1e-9, ahead / np.maximum(radius, 1e-12), 1.0)[:, None]
        if not self.is_fisheye and self.distortion[2:4].any():
            rays = _newton(self.matrix, self.distortion, pixels, rays, 8)
        return np.asarray(rays)


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
    length = 4 if camera.is_fisheye else 5
    return np.array([*camera.distortion, *[0.0] * length][:length], np.float64)


def lens_of(camera: CameraCalibration) -> Lens:
    """Return a camera's lens, at the size of its calibration."""
    return Lens(matrix_of(camera), distortion_of(camera), camera.is_fisheye)


def undistort_pixels(pixels: ArrayLike, matrix: Array, distortion: Array) -> Array:
    """Return a perspective lens's distorted pixels (n, 2) as x / z and y / z (n, 2) in the camera's frame."""
    return Lens(matrix, distortion).rays(pixels)


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


def project_rays(camera: CameraCalibration, rays: Array) -> Array:
    """Project rays (n, 2), x/z and y/z in the camera, to pixels (n, 2) of its lens's model."""
    if camera.is_fisheye:
        return lens_of(camera).project(rays)
    return _project(camera, rays)[0]


def rays_of(camera: CameraCalibration, pixels: Array) -> Array:
    """Return the rays (n, 2) of pixels (n, 2); NaN where the lens model has none."""
    if camera.is_fisheye:
        lens = lens_of(camera)
        return np.where(lens.known(pixels)[:, None], lens.rays(pixels), np.nan)
    rays = (pixels - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    rays = _newton(matrix_of(camera), distortion_of(camera), pixels, rays, _STEPS)
    with np.errstate(all="ignore"):
        seen, slopes, _ = _project(camera, rays)
        far = np.abs(seen - pixels).max(axis=1)
        # Past its turning point the polynomial maps rays from outside the image to the same pixel.
        turned = np.minimum(slopes[:, 0, 0], slopes[:, 1, 1]) <= 0
    rays[~(far < _FOUND_PX) | turned] = np.nan
    return np.asarray(rays)


def _newton(matrix: Array, distortion: Array, pixels: Array, rays: Array, steps: int) -> Array:
    """Improve the rays (n, 2) of a perspective lens's pixels (n, 2) by Newton's method."""
    focal = matrix[[0, 1], [0, 1]]
    with np.errstate(all="ignore"):
        for _ in range(steps):
            seen, slopes, _ = _project_perspective(matrix, distortion, rays)
            error = seen - pixels
            if not np.nanmax(np.abs(error / focal)) > 1e-13:
                break
            (a, b), (c, d) = slopes.transpose(1, 2, 0)
            step = np.stack([d * error[:, 0] - b * error[:, 1], a * error[:, 1] - c * error[:, 0]], axis=1)
            rays = rays - step / (a * d - b * c)[:, None]
    return rays


def picture_rays(camera: CameraCalibration) -> Array:
    """Return the rays (n, 2) of a grid over the whole image, edge to edge, for pixels that have one.

    Raises BadInputError if hardly any pixel has one, which no real lens does.
    """
    columns, rows = np.meshgrid(
        np.linspace(-0.5, camera.width - 0.5, _GRID), np.linspace(-0.5, camera.height - 0.5, _GRID)
    )
    rays = rays_of(camera, np.stack([columns.ravel(), rows.ravel()], axis=1))
    known = ~np.isnan(rays).any(axis=1)
    if known.mean() < 0.1:
        given = ", ".join(f"{value:.4g}" for value in distortion_of(camera))
        raise BadInputError(
            f"no lens has the distortion ({given}) at f = {camera.fx:.0f} px", hint="calibrate again"
        )
    return np.asarray(rays[known])


def without_k3(camera: CameraCalibration) -> tuple[CameraCalibration, float]:
    """Fit the closest lens with only k1, k2, p1 and p2 over the whole image.

    Returns it, with its own focal lengths and principal point, and the largest distance in px between the
    pixels to which both lenses map the same ray (least squares over a grid, Gauss-Newton).
    """
    if not distortion_of(camera)[4]:
        return camera, 0.0
    rays = picture_rays(camera)
    seen = project_rays(camera, rays)
    fitted = msgspec.structs.replace(camera, distortion=(*map(float, distortion_of(camera)[:4]), 0.0))
    for _ in range(_STEPS):
        _, _, slopes = _project(fitted, rays)
        scale = np.linalg.norm(slopes, axis=0)
        step = np.linalg.lstsq(slopes / scale, (seen - project_rays(fitted, rays)).ravel())[0] / scale
        fx, fy, cx, cy, *given = (np.array(_parameters(fitted)) + step).tolist()
        fitted = msgspec.structs.replace(fitted, fx=fx, fy=fy, cx=cx, cy=cy, distortion=(*given, 0.0))
        if np.abs(step[:4]).max() < 1e-9:
            break
    worst = float(np.linalg.norm(seen - project_rays(fitted, rays), axis=1).max())
    if not worst < max(camera.width, camera.height) or min(fitted.fx, fitted.fy) <= 0:
        # The fit failed: then images are redrawn without any distortion instead.
        fitted = msgspec.structs.replace(camera, distortion=(0.0,) * 5)
        worst = float(np.linalg.norm(seen - project_rays(fitted, rays), axis=1).max())
    return fitted, worst


def redrawing(camera: CameraCalibration, target: CameraCalibration) -> Redraw | None:
    """Return a function that redraws a camera's images for the lens `target`; None if the lenses are equal.

    The pose stays the same. Pixels are interpolated bilinearly; what the camera did not see is black.
    """
    import cv2

    size = (target.width, target.height)
    same_model = camera.is_fisheye == target.is_fisheye
    if (camera.width, camera.height) == size and same_model and _parameters(camera) == _parameters(target):
        return None
    if not lens_of(target).is_straight:
        rows, columns = np.mgrid[: target.height, : target.width].astype(np.float64)
        rays = rays_of(target, np.stack([columns.ravel(), rows.ravel()], axis=1))
        pixels = project_rays(camera, rays).astype(np.float32).reshape(target.height, target.width, 2)
        pixels[np.isnan(pixels)] = OUTSIDE
        maps = np.ascontiguousarray(pixels[..., 0]), np.ascontiguousarray(pixels[..., 1])
    else:
        maps = lens_of(camera).maps(size, matrix_of(target))
        across = (np.arange(target.width) - target.cx) / target.fx
        down = (np.arange(target.height) - target.cy) / target.fy
        # Far outside the image, the lens's polynomial may map rays back into it.
        unseen = (
            np.hypot(across[None], down[:, None]) > 1.01 * np.linalg.norm(picture_rays(camera), axis=1).max()
        )
        maps[0][unseen] = OUTSIDE
    for axis, length in zip(maps, (camera.width, camera.height), strict=True):
        # The image extends half a pixel beyond its outermost pixel centres.
        np.clip(axis, 0, length - 1, out=axis, where=(axis >= -0.51) & (axis <= length - 0.49))

    def redraw(picture: Picture) -> Picture:
        # OpenCV's bicubic kernel (a = -0.75) does not preserve a ramp: it shifts a smooth dot by up to 0.06
        # px.
        return np.asarray(cv2.remap(picture, *maps, cv2.INTER_LINEAR), np.uint8)

    return redraw


def _parameters(camera: CameraCalibration) -> tuple[float, ...]:
    given = distortion_of(camera)
    terms = given if camera.is_fisheye or given[4] else given[:4]
    return (camera.fx, camera.fy, camera.cx, camera.cy, *map(float, terms))


def _project(camera: CameraCalibration, rays: Array) -> tuple[Array, Array, Array]:
    """Return what `_project_perspective` does of a camera's lens."""
    return _project_perspective(matrix_of(camera), distortion_of(camera), rays)


def _project_perspective(matrix: Array, distortion: Array, rays: Array) -> tuple[Array, Array, Array]:
    """Return pixels (n, 2) of rays and their derivatives by the ray and by the lens parameters.

    By x and y of the ray: (n, 2, 2). By fx, fy, cx, cy, k1, k2, p1 and p2, for all pixels flattened: (2n, 8).
    """
    import cv2

    points, none = np.column_stack([rays, np.ones(len(rays))]), np.zeros(3)
    projected = cv2.projectPoints(points, none, none, matrix, distortion)
    pixels, slopes = (np.asarray(part, np.float64) for part in projected)
    return pixels.reshape(-1, 2), slopes[:, 3:5].reshape(-1, 2, 2), slopes[:, 6:14]
