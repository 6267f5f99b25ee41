"""Rerun's own .rrd: images and cameras on a timeline of the leader's clock. Needs rerun-sdk."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from capture_app.common.optional_packages import load_optional
from capture_app.session.exporters.common.exported_burst import ExportedBurst
from capture_app.session.exporters.common.files import jpeg_or_png
from capture_app.session.exporters.common.lens import centre_of, matrix_of, rotation_of
from capture_app.session.format.calibration import CameraCalibration

_HALF_PIXEL = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])  # Rerun's first pixel begins at (0, 0)


def write(burst: ExportedBurst, folder: Path) -> None:
    """Write <session>.rrd: entities rig/<camera>, timelines `leader` (exact to the ns) and `instant`.

    A camera's distortion has no place in it. Raises NotAvailableError without rerun-sdk.
    """
    rerun = load_optional("rerun", "rerun", "the .rrd format")
    file = f"{burst.name}.rrd"
    stream = rerun.RecordingStream("simulshot", recording_id=burst.name, send_properties=False)
    stream.save(folder / file)
    if burst.session.calibration() is not None:
        log_cameras(rerun, stream, burst.calibration("Rerun").cameras)
    images = [image for camera in burst.cameras for image in burst.images_of(camera)]
    for image in sorted(images, key=lambda image: (image.leader_ns, image.camera)):
        data, kind = jpeg_or_png(burst, image)
        set_times(stream, image.leader_ns, image.instant)
        stream.log(f"rig/{image.camera}", rerun.EncodedImage(contents=data, media_type=f"image/{kind}"))
        burst.put(image, file, len(burst.frames))
    stream.flush()
    stream.disconnect()


def log_cameras(rerun: Any, stream: Any, cameras: Mapping[str, CameraCalibration]) -> None:
    """Log where the cameras are, and how wide they look."""
    for name, camera in cameras.items():
        pose = rerun.Transform3D(translation=centre_of(camera), mat3x3=rotation_of(camera).T)
        pinhole = rerun.Pinhole(
            image_from_camera=matrix_of(camera) + _HALF_PIXEL,
            resolution=[camera.width, camera.height],
            camera_xyz=rerun.ViewCoordinates.RDF,
        )
        stream.log(f"rig/{name}", pose, pinhole, static=True)


def set_times(stream: Any, leader_ns: int, instant: int) -> None:
    """What is logged from now on is of this moment on both timelines."""
    stream.set_time("leader", duration=np.timedelta64(leader_ns, "ns"))
    stream.set_time("instant", sequence=instant)
