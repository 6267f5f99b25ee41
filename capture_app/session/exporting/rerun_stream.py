"""A recording for Rerun (.rrd): its cameras, images and times."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from capture_app.common.optional_packages import load_optional
from capture_app.session.format.calibration import CameraCalibration
from capture_app.session.format.lens import centre_of, matrix_of, rotation_of

_HALF_PIXEL = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])  # Rerun's first pixel begins at (0, 0)


@contextmanager
def rerun_recording(
    name: str, file: Path, cameras: Mapping[str, CameraCalibration]
) -> Iterator[tuple[Any, Any]]:
    """Write a recording with the cameras' poses and pinhole models; yield the package rerun and the stream.

    Raises NotAvailableError without rerun-sdk.
    """
    rerun = load_optional("rerun", "rerun", "the .rrd format")
    stream = rerun.RecordingStream("simulshot", recording_id=name, send_properties=False)
    stream.save(file)
    for camera_name, camera in cameras.items():
        pose = rerun.Transform3D(translation=centre_of(camera), mat3x3=rotation_of(camera).T)
        pinhole = rerun.Pinhole(
            image_from_camera=matrix_of(camera) + _HALF_PIXEL,
            resolution=[camera.width, camera.height],
            camera_xyz=rerun.ViewCoordinates.RDF,
        )
        stream.log(f"rig/{camera_name}", pose, pinhole, static=True)
    yield rerun, stream
    stream.flush()
    stream.disconnect()


def set_times(stream: Any, leader_ns: int, instant: int) -> None:
    """Set the time of everything logged from now on, on both timelines."""
    stream.set_time("leader", duration=np.timedelta64(leader_ns, "ns"))
    stream.set_time("instant", sequence=instant)
