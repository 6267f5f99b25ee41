"""OpenCV's lens model: pixels and rays, points from several cameras, and images redrawn for another lens."""

from collections.abc import Callable, Iterable

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
    """Return OpenCV's k1, k2, p1, p2, k3."""
    given = camera.distortion[:5]
    return np.array([*given, *[0.0] * (5 - len(given))], np.float64)


def undistort_pixels(pixels: ArrayLike, matrix: Array, distortion: Array) -> Array:
    """Return distorted pixels (n, 2) as x / z and y / z (n, 2) in the camera's frame."""
    import cv2

    points = np.asarray(pixels, np.float64).reshape(-1, 1, 2)
    # OpenCV's default of five steps leaves 30 px of error at the border of a 100 degree lens.
    until = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-8)
    if not len(points):
        return np.zeros((0, 2))  # of no points OpenCV returns one number
    return np.asarray(cv2.undistortPoints(points, matrix, distortion, criteria=until)).reshape(-1, 2)


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
    """Project rays (n, 2), x/z and y/z in the camera, to pixels (n, 2) with OpenCV's k1, k2, p1, p2, k3."""
    return _project(camera, rays)[0]


def rays_of(camera: CameraCalibration, pixels: Array) -> Array:
    """Return the rays (n, 2) of pixels (n, 2), by Newton's method; NaN where the lens model has none."""
    focal = np.array([camera.fx, camera.fy])
    rays = (pixels - [camera.cx, camera.cy]) / focal
    with np.errstate(all="ignore"):
        for _ in range(_STEPS):
            seen, slopes, _ = _project(camera, rays)
            error = seen - pixels
            if not np.nanmax(np.abs(error / focal)) > 1e-13:
                break
            (a, b), (c, d) = slopes.transpose(1, 2, 0)
            step = np.stack([d * error[:, 0] - b * error[:, 1], a * error[:, 1] - c * error[:, 0]], axis=1)
            rays = rays - step / (a * d - b * c)[:, None]
        seen, slopes, _ = _project(camera, rays)
        far = np.abs(seen - pixels).max(axis=1)
        # Past its turning point the polynomial maps rays from outside the image to the same pixel.
        turned = np.minimum(slopes[:, 0, 0], slopes[:, 1, 1]) <= 0
    rays[~(far < _FOUND_PX) | turned] = np.nan
    return np.asarray(rays)


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
    if (camera.width, camera.height) == size and _parameters(camera) == _parameters(target):
        return None
    if distortion_of(target).any():
        rows, columns = np.mgrid[: target.height, : target.width].astype(np.float64)
        rays = rays_of(target, np.stack([columns.ravel(), rows.ravel()], axis=1))
        pixels = project_rays(camera, rays).astype(np.float32).reshape(target.height, target.width, 2)
        pixels[np.isnan(pixels)] = -10
        maps = (np.ascontiguousarray(pixels[..., 0]), np.ascontiguousarray(pixels[..., 1]))
    else:
        maps = cv2.initUndistortRectifyMap(
            matrix_of(camera), distortion_of(camera), np.eye(3), matrix_of(target), size, cv2.CV_32FC1
        )
        across = (np.arange(target.width) - target.cx) / target.fx
        down = (np.arange(target.height) - target.cy) / target.fy
        # Far outside the image, the lens's polynomial may map rays back into it.
        unseen = (
            np.hypot(across[None], down[:, None]) > 1.01 * np.linalg.norm(picture_rays(camera), axis=1).max()
        )
        maps[0][unseen] = -10
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
    return (camera.fx, camera.fy, camera.cx, camera.cy, *map(float, given if given[4] else given[:4]))


def _project(camera: CameraCalibration, rays: Array) -> tuple[Array, Array, Array]:
    """Return pixels (n, 2) of rays and their derivatives by the ray and by the lens parameters.

    By x and y of the ray: (n, 2, 2). By fx, fy, cx, cy, k1, k2, p1 and p2, for all pixels flattened: (2n, 8).
    """
    import cv2

    points, none = np.column_stack([rays, np.ones(len(rays))]), np.zeros(3)
    projected = cv2.projectPoints(points, none, none, matrix_of(camera), distortion_of(camera))
    pixels, slopes = (np.asarray(part, np.float64) for part in projected)
    return pixels.reshape(-1, 2), slopes[:, 3:5].reshape(-1, 2, 2), slopes[:, 6:14]
