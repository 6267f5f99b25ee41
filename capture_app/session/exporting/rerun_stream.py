"""Cameras and times in a Rerun recording stream; the caller has imported rerun-sdk."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from capture_app.session.format.calibration import CameraCalibration
from capture_app.session.format.lens import centre_of, matrix_of, rotation_of

_HALF_PIXEL = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])  # Rerun's first pixel begins at (0, 0)


def log_cameras(rerun: Any, stream: Any, cameras: Mapping[str, CameraCalibration]) -> None:
    """Log the cameras' poses and pinhole models."""
    for name, camera in cameras.items():
        pose = rerun.Transform3D(translation=centre_of(camera), mat3x3=rotation_of(camera).T)
        pinhole = rerun.Pinhole(
            image_from_camera=matrix_of(camera) + _HALF_PIXEL,
            resolution=[camera.width, camera.height],
            camera_xyz=rerun.ViewCoordinates.RDF,
        )
        stream.log(f"rig/{name}", pose, pinhole, static=True)


def set_times(stream: Any, leader_ns: int, instant: int) -> None:
    """Set the time of everything logged from now on, on both timelines."""
    stream.set_time("leader", duration=np.timedelta64(leader_ns, "ns"))
    stream.set_time("instant", sequence=instant)
