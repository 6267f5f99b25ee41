"""Neural 3D Video: camNN.mp4, one frame an instant, and poses_bounds.npy as LLFF defined it."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from capture_app.errors import BadInputError
from capture_app.session.exporters.common.exported_burst import ExportedBurst, ExportOptions, Picture
from capture_app.session.exporters.common.poses import Array, centre_of, distortion_of, matrix_of, rotation_of
from capture_app.session.exporters.common.tables import Frame, write_frames
from capture_app.session.exporters.common.videos import spacing_notes, write_video
from capture_app.session.format.calibration import CameraCalibration

_NEAR, _FAR = 0.2, 5.0
"""Guessed bounds as shares of the distance at which the cameras' axes meet."""


def write(burst: ExportedBurst, folder: Path, options: ExportOptions) -> list[str]:
    """Write the videos of the instants that every camera has, and a row of 17 numbers a camera.

    The format knows one focal length, no distortion, and a principal point in the middle: the images are
    remapped to that. Raises BadInputError where the sizes differ or no instant is complete.
    """
    calibration = burst.calibration("N3DV")
    cameras = {name: calibration.cameras[name] for name in burst.cameras}
    size = _one_size(burst)
    together = [
        instant
        for instant in range(len(burst.instants_ns))
        if all(burst.image_at(camera, instant) for camera in burst.cameras)
    ]
    if not together:
        raise BadInputError(f"{burst.session.folder}: no instant has an image of every camera, as N3DV needs")
    focal = float(np.mean([(camera.fx + camera.fy) / 2 for camera in cameras.values()]))
    frames, rows = [], []
    depths = focus_depths(cameras)
    for number, (name, camera) in enumerate(cameras.items()):
        file = f"cam{number:02d}.mp4"
        frames += _video(burst, name, together, _Remap(camera, focal), folder, file)
        rows.append([*_pose(camera, size, focal).ravel(), *_bounds(options, depths[name])])
    np.save(folder / "poses_bounds.npy", np.array(rows, np.float64))
    write_frames(burst, folder, frames)
    return _notes(burst, together, options)


def focus_depths(cameras: Mapping[str, CameraCalibration]) -> dict[str, float]:
    """For each camera the depth, in the calibration's unit, of the point nearest to all optical axes.

    Where the axes do not meet in front of the cameras, ten times the widest distance between two.
    """
    centres = np.array([centre_of(camera) for camera in cameras.values()])
    axes = np.array([rotation_of(camera)[2] for camera in cameras.values()])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    normal = across.sum(axis=0)
    widest = max((float(np.linalg.norm(a - b)) for a in centres for b in centres), default=0.0)
    if np.linalg.cond(normal) < 1e4:
        point = np.linalg.solve(normal, np.einsum("nij,nj->i", across, centres))
        depths = np.einsum("nj,nj->n", axes, point - centres)
        if depths.min() > 0:
            return dict(zip(cameras, map(float, depths), strict=True))
    return dict.fromkeys(cameras, 10 * widest or 1.0)


class _Remap:
    """A camera's images without distortion, of this focal length in pixels, the principal point centred."""

    def __init__(self, camera: CameraCalibration, focal: float) -> None:
        import cv2

        x, y = (camera.width - 1) / 2, (camera.height - 1) / 2
        wanted = np.array([[focal, 0, x], [0, focal, y], [0, 0, 1]])
        self._maps = None
        if distortion_of(camera).any() or abs(wanted - matrix_of(camera)).max() > 1e-6:
            self._maps = cv2.initUndistortRectifyMap(
                matrix_of(camera),
                distortion_of(camera),
                np.eye(3),
                wanted,
                (camera.width, camera.height),
                cv2.CV_32FC1,
            )

    def __call__(self, picture: Picture) -> Picture:
        import cv2

        if self._maps is None:
            return picture
        return np.asarray(cv2.remap(picture, *self._maps, cv2.INTER_LINEAR), np.uint8)


def _video(
    burst: ExportedBurst, camera: str, instants: list[int], remap: _Remap, folder: Path, file: str
) -> list[Frame]:
    images = [burst.images[camera, instant] for instant in instants]
    start_ns = burst.instants_ns[instants[0]]
    pictures = ((burst.instants_ns[image.instant] - start_ns, remap(burst.pixels(image))) for image in images)
    write_video(folder / file, pictures, burst.size(camera), burst.period_ns)
    return [Frame(camera, image.instant, file, number, image) for number, image in enumerate(images)]


def _bounds(options: ExportOptions, depth: float) -> tuple[float, float]:
    near, far = options.near or _NEAR * depth, options.far or _FAR * depth
    if near >= far:
        raise BadInputError(f"the nearest depth, {near:.4g}, is not less than the farthest, {far:.4g}")
    return near, far


def _pose(camera: CameraCalibration, size: tuple[int, int], focal: float) -> Array:
    """LLFF's 3x5: the camera's down, right and back axes, its centre, and (height, width, focal length)."""
    right, down, forward = rotation_of(camera)
    intrinsics = np.array([size[1], size[0], focal], np.float64)
    return np.stack([down, right, -forward, centre_of(camera), intrinsics], axis=1)


def _one_size(burst: ExportedBurst) -> tuple[int, int]:
    sizes = {burst.size(camera) for camera in burst.cameras}
    if len(sizes) > 1:
        found = ", ".join(f"{name} {burst.size(name)[0]}x{burst.size(name)[1]}" for name in burst.cameras)
        raise BadInputError(f"N3DV needs cameras of one size; {burst.session.folder} has {found}")
    return sizes.pop()


def _notes(burst: ExportedBurst, together: list[int], options: ExportOptions) -> list[str]:
    names = {f"cam{number:02d}": camera for number, camera in enumerate(burst.cameras)}
    notes = [f"{name} is {camera}" for name, camera in names.items() if name != camera]
    left_out = len(burst.instants_ns) - len(together)
    if left_out:
        notes.append(
            f"{left_out} of {len(burst.instants_ns)} instants are left out: not every camera has them"
        )
    if options.near is None or options.far is None:
        notes.append(
            "near and far are guessed from where the cameras look; `sessions export` takes --near and --far"
        )
    return notes + spacing_notes([burst.instants_ns[instant] for instant in together], burst.period_ns)
