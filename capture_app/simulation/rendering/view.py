"""One camera of the scene: a pinhole without distortion, its rows read one after the other."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture_app.session.format.calibration import CameraCalibration
from capture_app.simulation.scenes.meshes import Floats


@dataclass(frozen=True, eq=False)
class View:
    """Pinhole camera: x_cam = rotation x_world + translation in m, centres of pixels at integers."""

    name: str
    width: int
    height: int
    focal_px: float
    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]

    @property
    def principal_point(self) -> tuple[float, float]:
        """Image point of the optical axis in px: the middle of the picture."""
        return (self.width - 1) / 2, (self.height - 1) / 2

    @property
    def matrix(self) -> NDArray[np.float64]:
        """Camera matrix (3, 3)."""
        cx, cy = self.principal_point
        return np.array([[self.focal_px, 0, cx], [0, self.focal_px, cy], [0, 0, 1.0]])

    @property
    def centre(self) -> Floats:
        """Place of the camera in the world, in m."""
        return (-self.rotation.T @ self.translation).astype(np.float32)

    def directions(self, right: float = 0.0, down: float = 0.0) -> Floats:
        """World directions (H, W, 3) of unit depth through the pixels, moved by a part of a pixel."""
        cx, cy = self.principal_point
        x = (np.arange(self.width) + right - cx) / self.focal_px
        y = (np.arange(self.height) + down - cy) / self.focal_px
        grid = np.stack([*np.meshgrid(x, y), np.ones((self.height, self.width))], axis=-1)
        return (grid @ self.rotation).astype(np.float32)

    def project(self, points: ArrayLike) -> NDArray[np.float64]:
        """Image points and depth (N, 3: px, px, m) of world points (N, 3) in m."""
        camera = np.asarray(points, np.float64) @ self.rotation.T + self.translation
        cx, cy = self.principal_point
        x = self.focal_px * camera[:, 0] / camera[:, 2] + cx
        y = self.focal_px * camera[:, 1] / camera[:, 2] + cy
        return np.stack([x, y, camera[:, 2]], axis=1)

    def calibration(self) -> CameraCalibration:
        """Return this camera as a session's calibration keeps it; the rig's frame is the world's."""
        cx, cy = self.principal_point
        right, down, ahead = ((float(a), float(b), float(c)) for a, b, c in self.rotation)
        x, y, z = (float(v) for v in self.translation)
        return CameraCalibration(
            width=self.width, height=self.height, fx=self.focal_px, fy=self.focal_px, cx=cx, cy=cy,
            rotation=(right, down, ahead), translation=(x, y, z),
        )  # fmt: skip


def look_at(name: str, place: ArrayLike, target: ArrayLike, *, scale: float = 1.0) -> View:
    """Upright camera of 640x480 px (times `scale`) and 520 px focal length that looks at `target`, in m."""
    centre = np.asarray(place, np.float64)
    ahead = np.asarray(target, np.float64) - centre
    ahead /= np.linalg.norm(ahead)
    right = np.cross([0.0, 1.0, 0.0], ahead)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(ahead, right), ahead])
    width, height = round(640 * scale), round(480 * scale)
    return View(name, width, height, 520.0 * scale, rotation, -rotation @ centre)
