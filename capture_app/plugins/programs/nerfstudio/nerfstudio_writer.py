"""nerfstudio: transforms.json with poses in OpenGL's camera axes and the time of every image."""

import json
from pathlib import Path

import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.session.exporting.exported_burst import ExportedBurst, suffix_for, write_mask
from capture_app.session.exporting.exporter import Exporter, Masks, Points
from capture_app.session.exporting.pinhole import opengl_pose
from capture_app.session.exporting.point_cloud import read_ply, write_ply
from capture_app.session.format.calibration import CameraCalibration
from capture_app.session.format.lens import distortion_of
from capture_app.session.format.manifest import ImageRecord

_POINTS = "sparse_pc.ply"
_HALF_PIXEL = 0.5  # nerfstudio's first pixel has its centre at (0.5, 0.5)
_TERMS = {False: ("k1", "k2", "p1", "p2", "k3"), True: ("k1", "k2", "k3", "k4")}


def write(burst: ExportedBurst, folder: Path, *, masks: Masks = None, points: Points = None) -> None:
    """Write images/<camera>/<instant> and transforms.json, points and masks if given.

    `time` runs from 0 at the burst's first image to 1 at its last, each image at its own; `leader_ns` beside
    it is exact. Without a second instant every `time` is 0. nerfstudio itself ignores it.
    """
    calibration = burst.required_calibration
    fisheyes = [calibration.cameras[camera].is_fisheye for camera in burst.cameras]
    if any(fisheyes) and not all(fisheyes):
        raise BadInputError(
            "nerfstudio has one lens model for all cameras, and these are fisheyes and perspective ones",
            hint="export to colmap, or to splats",
        )
    images = [image for camera in burst.cameras for image in burst.images_of(camera)]
    if masks:
        # Substitutes for dropped frames have no masks, and nerfstudio requires all or none.
        images = [image for image in images if not image.substitute]
    suffix = suffix_for(burst, images)
    span_ns = max(image.leader_ns for image in images) - burst.origin_ns
    several = len({image.instant for image in images}) > 1
    entries = []
    for image in images:
        file = f"images/{image.camera}/{image.instant:06d}{suffix}"
        burst.write_image(image, folder, file)
        time = (image.leader_ns - burst.origin_ns) / span_ns if several else 0.0
        entry = _entry(file, image, calibration.cameras[image.camera], time)
        if masks:
            # nerfstudio excludes black areas from its losses.
            entry["mask_path"] = f"masks/{image.camera}/{image.instant:06d}.png"
            write_mask(burst, masks, image, folder / str(entry["mask_path"]), movers=0)
        entries.append(entry)
    content: dict[str, object] = {
        "camera_model": "OPENCV_FISHEYE" if any(fisheyes) else "OPENCV",
        "time_origin_leader_ns": burst.origin_ns,
        "time_span_ns": span_ns if several else 0,
        "unit": calibration.unit,
        "frames": entries,
    }
    if points:
        content["ply_file_path"] = _POINTS
        cloud = read_ply(points)
        write_ply(folder / _POINTS, cloud, np.zeros_like(cloud.points))
    (folder / "transforms.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    if several:
        burst.notes.append(
            "nerfstudio itself takes all instants for one moment: `--instant` exports one; "
            "4D methods read `time`"
        )


def _entry(file: str, image: ImageRecord, camera: CameraCalibration, time: float) -> dict[str, object]:
    return {
        "file_path": file,
        "fl_x": camera.fx,
        "fl_y": camera.fy,
        "cx": camera.cx + _HALF_PIXEL,
        "cy": camera.cy + _HALF_PIXEL,
        "w": camera.width,
        "h": camera.height,
        **dict(zip(_TERMS[camera.is_fisheye], distortion_of(camera).tolist(), strict=True)),
        "transform_matrix": opengl_pose(camera).tolist(),
        "time": time,
        "camera": image.camera,
        "instant": image.instant,
        "leader_ns": image.leader_ns,
        "uncertainty_ns": image.uncertainty_ns,
    }


EXPORTER = Exporter(
    write=write,
    help="transforms.json with the time of every image",
    program="nerfstudio",
    one_instant=True,
    calibration="required",
    fisheyes=True,
)
