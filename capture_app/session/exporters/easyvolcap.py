"""EasyVolcap and its descendants (4K4D, ENeRF): images/<camera>/<frame>, intri.yml, extri.yml, masks."""

from pathlib import Path

import msgspec
import numpy as np

from capture_app.errors import BadInputError
from capture_app.session.exporters.common.exported_burst import ExportedBurst, ExportOptions
from capture_app.session.exporters.common.files import place, place_redrawn, suffix_for, write_mask
from capture_app.session.exporters.common.lens import distortion_of, matrix_of, redrawing
from capture_app.session.exporters.common.tables import (
    Frame,
    renaming_notes,
    unit_note,
    write_cameras,
    write_frames,
    yaml_names,
)
from capture_app.session.exporters.common.videos import spacing_notes
from capture_app.session.format.calibration import CameraCalibration

_HALF_PIXEL = 0.5  # EasyVolcap's rays leave the first pixel at (0.5, 0.5)


def write(burst: ExportedBurst, folder: Path, options: ExportOptions) -> list[str]:
    """Write the instants that every camera has, counted from 0, the cameras in metres, and masks if given.

    EasyVolcap undoes a distortion with the first pixel at (0, 0) and sends its rays from (0.5, 0.5): with
    either principal point a distorted camera is wrong by half a pixel. So the pictures of one are redrawn
    without its distortion. Raises BadInputError where no instant is complete.
    """
    calibration = burst.calibration("EasyVolcap")
    together = burst.complete_instants()
    if not together:
        raise BadInputError(f"{burst.session.folder}: no instant has an image of every camera")
    names = yaml_names(burst.cameras)
    straight = {name: _straight(calibration.cameras[name]) for name in burst.cameras}
    redraws = {name: redrawing(calibration.cameras[name], straight[name]) for name in burst.cameras}
    burst.drawn.update(straight)
    numbers = {instant: number for number, instant in enumerate(together)}
    images = [burst.images[camera, instant] for camera in burst.cameras for instant in together]
    redrawn = any(redraws.values())
    suffix = ".png" if redrawn and options.lossless else ".jpg" if redrawn else suffix_for(burst, images)
    frames = []
    for image in images:
        number = numbers[image.instant]
        file = f"images/{names[image.camera]}/{number:06d}{suffix}"
        redraw = redraws[image.camera]
        if redrawn:
            place_redrawn(burst, image, folder / file, redraw)
        else:
            place(burst, image, folder / file, options)
        if options.masks:
            target = folder / "masks" / names[image.camera] / f"{number:06d}.png"
            write_mask(burst, options.masks, image, target, movers=255, redraw=redraw)
        frames.append(Frame(image.camera, image.instant, file, number, image))
    cameras = msgspec.structs.replace(calibration, cameras=straight)
    write_cameras(folder, cameras, names, centre=_HALF_PIXEL)
    write_frames(burst, folder, frames)
    notes = renaming_notes(names)
    if len(together) < len({instant for _, instant in burst.images}):
        notes.append("instants that not every camera has are left out")
    if redrawn:
        notes.append("the pictures are redrawn without distortion")
    times_ns = [burst.instants_ns[instant] for instant in together]
    return [*notes, *spacing_notes(times_ns, burst.period_ns), *unit_note(calibration, "m")]


def _straight(camera: CameraCalibration) -> CameraCalibration:
    """The camera without distortion, with the widest view that its picture fills."""
    import cv2

    if not distortion_of(camera).any():
        return camera
    size = (camera.width, camera.height)
    matrix = cv2.getOptimalNewCameraMatrix(matrix_of(camera), distortion_of(camera), size, 0)[0]
    fx, fy, cx, cy = (float(np.asarray(matrix)[place]) for place in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return msgspec.structs.replace(camera, fx=fx, fy=fy, cx=cx, cy=cy, distortion=(0.0,) * 5)
