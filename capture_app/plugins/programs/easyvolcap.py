"""EasyVolcap and its descendants (4K4D, ENeRF): images/<camera>/<frame>, intri.yml, extri.yml, masks."""

from pathlib import Path

import numpy as np
from msgspec import structs

from capture_app.session.exporting.csv_tables import (
    renaming_notes,
    write_cameras,
    yaml_names,
)
from capture_app.session.exporting.exported_burst import ExportedBurst, suffix_for, write_mask
from capture_app.session.exporting.exporter import Exporter, Masks
from capture_app.session.exporting.videos import spacing_notes
from capture_app.session.format.calibration import CameraCalibration
from capture_app.session.format.lens import distortion_of, matrix_of, redrawing

_HALF_PIXEL = 0.5  # EasyVolcap's rays leave the first pixel at (0.5, 0.5)


def write(burst: ExportedBurst, folder: Path, *, masks: Masks = None) -> None:
    """Write the instants that every camera has, counted from 0, the cameras in metres, and masks if given.

    EasyVolcap undistorts with the first pixel at (0, 0), but casts its rays from (0.5, 0.5). With either
    principal point a distorted camera is wrong by half a pixel, so its images are undistorted here.
    """
    calibration, together = burst.required_calibration, burst.complete_instants()
    names = yaml_names(burst.cameras)
    straight = {name: _straight(calibration.cameras[name]) for name in burst.cameras}
    redraws = {name: redrawing(calibration.cameras[name], straight[name]) for name in burst.cameras}
    burst.drawn.update(straight)
    numbers = {instant: number for number, instant in enumerate(together)}
    images = [burst.images[camera, instant] for camera in burst.cameras for instant in together]
    redrawn = any(redraws.values())
    encoded = ".png" if burst.lossless else ".jpg"
    suffix = encoded if redrawn else suffix_for(burst, images)
    for image in images:
        number, redraw = numbers[image.instant], redraws[image.camera]
        file = f"{names[image.camera]}/{number:06d}"
        encoder = redraw or np.asarray if redrawn else None
        burst.write_image(image, folder, f"images/{file}{suffix}", encoder, number)
        write_mask(burst, masks, image, folder / f"masks/{file}.png", movers=255, redraw=redraw)
    write_cameras(folder, structs.replace(calibration, cameras=straight), names, centre=_HALF_PIXEL)
    burst.notes += renaming_notes(names)
    if len(together) < len({instant for _, instant in burst.images}):
        burst.notes.append("instants that not every camera has are left out")
    if redrawn:
        burst.notes.append("the pictures are redrawn without distortion")
    burst.notes += spacing_notes([burst.instants_ns[instant] for instant in together], burst.period_ns)


def _straight(camera: CameraCalibration) -> CameraCalibration:
    """Return the camera without distortion, with the widest view that its image fills."""
    import cv2

    if not distortion_of(camera).any():
        return camera
    size = (camera.width, camera.height)
    matrix = cv2.getOptimalNewCameraMatrix(matrix_of(camera), distortion_of(camera), size, 0)[0]
    (fx, _, cx), (_, fy, cy), _ = np.asarray(matrix).tolist()
    return structs.replace(camera, fx=fx, fy=fy, cx=cx, cy=cy, distortion=(0.0,) * 5)


EXPORTER = Exporter(
    write=write,
    help="EasyVolcap: images, intri.yml and extri.yml",
    program="EasyVolcap",
    one_instant=True,
    calibration="required",
    unit="m",
    complete_instants=True,
)
