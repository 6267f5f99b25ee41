"""OpenCV's lens model: its nearest form without k3, images redrawn for a lens, other conventions."""

import msgspec
import numpy as np
from numpy.typing import NDArray

from capture_app.common.errors import BadInputError
from capture_app.session.exporting.exported_burst import Picture, Redraw
from capture_app.session.format.calibration import CameraCalibration

Array = NDArray[np.float64]
_STEPS = 30
_FOUND_PX = 1e-6
_GRID = 60


def rotation_of(camera: CameraCalibration) -> Array:
    """Rotation of `cam_from_rig`, 3x3."""
    return np.array(camera.rotation, np.float64)


def translation_of(camera: CameraCalibration) -> Array:
    """Translation of `cam_from_rig`, (3,), in the calibration's unit."""
    return np.array(camera.translation, np.float64)


def centre_of(camera: CameraCalibration) -> Array:
    """Position of the camera in the rig's coordinates, (3,), in the calibration's unit."""
    return np.asarray(-rotation_of(camera).T @ translation_of(camera))


def matrix_of(camera: CameraCalibration) -> Array:
    """OpenCV's camera matrix, 3x3, in pixels; the first pixel's centre is (0, 0)."""
    return np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]], np.float64)


def distortion_of(camera: CameraCalibration) -> Array:
    """OpenCV's k1, k2, p1, p2, k3."""
    given = camera.distortion[:5]
    return np.array([*given, *[0.0] * (5 - len(given))], np.float64)


def quaternion(rotation: Array) -> tuple[float, float, float, float]:
    """Unit quaternion (w, x, y, z), w >= 0, of a rotation matrix (Horn 1987, section 4)."""
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


def rodrigues(rotation: Array) -> tuple[float, float, float]:
    """Rotation vector in radians of a rotation matrix."""
    import cv2

    x, y, z = cv2.Rodrigues(rotation)[0].ravel().tolist()
    return x, y, z


def project_rays(camera: CameraCalibration, rays: Array) -> Array:
    """Pixels (n, 2) of rays (n, 2), which are x/z and y/z in the camera; OpenCV's k1, k2, p1, p2, k3."""
    return _project(camera, rays)[0]


def rays_of(camera: CameraCalibration, pixels: Array) -> Array:
    """Rays (n, 2) of pixels (n, 2), by Newton's method; NaN where the lens has none there."""
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
        # Past its turning point a polynomial shows the same pixel again, seen from outside the picture.
        turned = np.minimum(slopes[:, 0, 0], slopes[:, 1, 1]) <= 0
    rays[~(far < _FOUND_PX) | turned] = np.nan
    return np.asarray(rays)


def picture_rays(camera: CameraCalibration) -> Array:
    """Rays (n, 2) of a grid over the whole picture, from edge to edge, of those pixels that have one.

    Raises BadInputError where hardly any has: no lens does that.
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
    """The lens with k1, k2, p1 and p2 only that comes nearest in the whole picture.

    Returns it, with its own focal lengths and principal point, and the largest distance in px between the
    pixels that both give a ray of the picture (least squares over a grid, Gauss-Newton).
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
        fx, fy, cx, cy, *given = np.array(_parameters(fitted)) + step
        fitted = msgspec.structs.replace(
            fitted,
            fx=float(fx),
            fy=float(fy),
            cx=float(cx),
            cy=float(cy),
            distortion=(*map(float, given), 0.0),
        )
        if np.abs(step[:4]).max() < 1e-9:
            break
    worst = float(np.linalg.norm(seen - project_rays(fitted, rays), axis=1).max())
    if not worst < max(camera.width, camera.height) or min(fitted.fx, fitted.fy) <= 0:
        # Nothing like it: then the pictures are as well drawn without any distortion.
        fitted = msgspec.structs.replace(camera, distortion=(0.0,) * 5)
        worst = float(np.linalg.norm(seen - project_rays(fitted, rays), axis=1).max())
    return fitted, worst


def redrawing(camera: CameraCalibration, wanted: CameraCalibration) -> Redraw | None:
    """Makes of a camera's pictures those that the lens `wanted` had taken from there; None if it is the same.

    Pixels are interpolated (bilinear); what the camera did not see is black.
    """
    import cv2

    sizes = {(lens.width, lens.height) for lens in (camera, wanted)}
    if len(sizes) == 1 and _parameters(camera) == _parameters(wanted):
        return None
    if distortion_of(wanted).any():
        rows, columns = np.mgrid[: wanted.height, : wanted.width].astype(np.float64)
        rays = rays_of(wanted, np.stack([columns.ravel(), rows.ravel()], axis=1))
        pixels = project_rays(camera, rays).astype(np.float32).reshape(wanted.height, wanted.width, 2)
        pixels[np.isnan(pixels)] = -10
        maps = (np.ascontiguousarray(pixels[..., 0]), np.ascontiguousarray(pixels[..., 1]))
    else:
        size = (wanted.width, wanted.height)
        maps = cv2.initUndistortRectifyMap(
            matrix_of(camera), distortion_of(camera), np.eye(3), matrix_of(wanted), size, cv2.CV_32FC1
        )
        across = (np.arange(wanted.width) - wanted.cx) / wanted.fx
        down = (np.arange(wanted.height) - wanted.cy) / wanted.fy
        # Far outside its picture a lens's polynomial may turn back into it.
        unseen = (
            np.hypot(across[None], down[:, None]) > 1.01 * np.linalg.norm(picture_rays(camera), axis=1).max()
        )
        maps[0][unseen] = -10
    for axis, length in zip(maps, (camera.width, camera.height), strict=True):
        # Half a pixel around the outermost centres still belongs to the picture.
        inside = (axis >= -0.51) & (axis <= length - 0.49)
        np.clip(axis, 0, length - 1, out=axis, where=inside)

    def redraw(picture: Picture) -> Picture:
        # OpenCV's bicubic kernel (a = -0.75) does not keep a ramp: it moves a smooth dot by up to 0.06 px.
        return np.asarray(cv2.remap(picture, *maps, cv2.INTER_LINEAR), np.uint8)

    return redraw


def _parameters(camera: CameraCalibration) -> tuple[float, ...]:
    given = distortion_of(camera)
    return (camera.fx, camera.fy, camera.cx, camera.cy, *map(float, given if given[4] else given[:4]))


def _project(camera: CameraCalibration, rays: Array) -> tuple[Array, Array, Array]:
    """Pixels (n, 2) of rays, their derivatives (n, 2, 2) by x and y of the ray, and those of all pixels,
    flattened, by fx, fy, cx, cy, k1, k2, p1 and p2 (2n, 8)."""
    import cv2

    points, none = np.column_stack([rays, np.ones(len(rays))]), np.zeros(3)
    found = cv2.projectPoints(points, none, none, matrix_of(camera), distortion_of(camera))
    pixels, slopes = (np.asarray(one, np.float64) for one in found)
    return pixels.reshape(-1, 2), slopes[:, 3:5].reshape(-1, 2, 2), slopes[:, 6:14]
