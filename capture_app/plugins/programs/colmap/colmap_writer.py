"""COLMAP (4.x): images of one rig, rig_config.json, and with a calibration a sparse model as text."""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from capture_app.common.text import count
from capture_app.session.exporting.exported_burst import ExportedBurst, suffix_for, write_mask
from capture_app.session.exporting.exporter import Exporter, Masks, Points
from capture_app.session.exporting.point_cloud import PointCloud, read_ply
from capture_app.session.exporting.starting_points import visible_pixels
from capture_app.session.format.calibration import Calibration, CameraCalibration
from capture_app.session.format.lens import (
    Array,
    distortion_of,
    quaternion,
    rotation_of,
    translation_of,
)
from capture_app.session.format.manifest import RIG

_HALF_PIXEL = 0.5  # COLMAP's first pixel has its centre at (0.5, 0.5)
_MAX_TRACKS = 2000
"""Maximum number of points with a track; COLMAP's stereo and fusion pair images by common points."""


def write(burst: ExportedBurst, folder: Path, *, masks: Masks = None, points: Points = None) -> None:
    """Write images/rig1/<camera>/<instant>, rig_config.json, and sparse/0 if the session is calibrated.

    The first camera is the rig's reference sensor; the model's world is the calibration's rig. A substitute
    for a dropped frame was taken at a different time than its rig frame, and is left out.
    """
    if burst.calibration is not None:
        burst.notes.append("sparse/0 is for COLMAP: trainers of Gaussian splats need --to splats")
    exported = [
        image
        for instant in range(len(burst.instants_ns))
        for camera in burst.cameras
        if (image := burst.image_at(camera, instant)) is not None
    ]
    if len(exported) < len(burst.images):
        images = count(len(burst.images) - len(exported), "image")
        burst.notes.append(f"left out: {images} of other moments than their instants")
    suffix = suffix_for(burst, exported)
    names = {}
    for image in exported:
        name = f"{RIG}/{image.camera}/{image.instant:06d}{suffix}"
        names[image.camera, image.instant] = name
        burst.write_image(image, folder, f"images/{name}")
        # COLMAP detects no features where a mask is black.
        write_mask(burst, masks, image, folder / "masks" / f"{name}.png", movers=0)
    config = json.dumps(_rig_config(burst.cameras, burst.calibration), indent=1)
    (folder / "rig_config.json").write_text(config + "\n", encoding="utf-8")
    if burst.calibration is not None:
        cloud = read_ply(points) if points else None
        _write_model(burst, burst.calibration, names, cloud, folder / "sparse/0")


def _rig_config(cameras: tuple[str, ...], calibration: Calibration | None) -> list[dict[str, object]]:
    sensors: list[dict[str, object]] = []
    for name in cameras:
        sensor: dict[str, object] = {"image_prefix": f"{RIG}/{name}/"}
        if name == cameras[0]:
            sensor["ref_sensor"] = True
        elif calibration is not None:
            pose = _from_reference(calibration.cameras[cameras[0]], calibration.cameras[name])
            sensor["cam_from_rig_rotation"] = list(quaternion(pose[0]))
            sensor["cam_from_rig_translation"] = pose[1].tolist()
        if calibration is not None:
            sensor["camera_model_name"], sensor["camera_params"] = _model(calibration.cameras[name])
        sensors.append(sensor)
    return [{"cameras": sensors}]


def _write_model(
    burst: ExportedBurst,
    calibration: Calibration,
    names: Mapping[tuple[str, int], str],
    cloud: PointCloud | None,
    folder: Path,
) -> None:
    """Write a COLMAP model of the images `names` (by camera and instant) and of the points of a cloud.

    At most `_MAX_TRACKS` points have a track.
    """
    numbers = {name: number for number, name in enumerate(burst.cameras, 1)}
    lenses = {name: calibration.cameras[name] for name in numbers}
    reference = lenses[burst.cameras[0]]
    poses = {name: _pose(rotation_of(lens), translation_of(lens)) for name, lens in lenses.items()}
    models = ((number, lenses[name], *_model(lenses[name])) for name, number in numbers.items())
    cameras = [
        f"{n} {model} {lens.width} {lens.height} {_numbers(parameters)}"
        for n, lens, model, parameters in models
    ]
    sensors = [
        f"CAMERA {numbers[name]} 1 {_pose(*_from_reference(reference, lenses[name]))}"
        for name in burst.cameras[1:]
    ]
    ids = {place: number for number, place in enumerate(names, 1)}
    data = {
        instant: [f"CAMERA {numbers[c]} {ids[c, instant]}" for c in burst.cameras if (c, instant) in ids]
        for instant in sorted({instant for _, instant in ids})
    }
    frames = [
        f"{instant + 1} 1 {poses[burst.cameras[0]]} {len(images)} {' '.join(images)}"
        for instant, images in data.items()
    ]
    points, seen = [], dict.fromkeys(numbers, "")
    if cloud is not None:
        seen, tracks = _observe(lenses, ids, cloud.points)
        points = [
            f"{number} {_numbers(point)} {' '.join(map(str, colour))} 0{tracks.get(number, '')}"
            for number, (point, colour) in enumerate(
                zip(cloud.points.tolist(), cloud.colours.tolist(), strict=True), 1
            )
        ]
    images = [
        f"{ids[place]} {poses[place[0]]} {numbers[place[0]]} {name}\n{seen[place[0]]}"
        for place, name in names.items()
    ]
    rig = " ".join([f"1 {len(numbers)} CAMERA 1", *sensors])
    lines = {"cameras": cameras, "rigs": [rig], "frames": frames, "images": images, "points3D": points}
    folder.mkdir(parents=True)
    for file, content in lines.items():
        (folder / f"{file}.txt").write_text("".join(f"{line}\n" for line in content), encoding="utf-8")


def _observe(
    lenses: Mapping[str, CameraCalibration], ids: Mapping[tuple[str, int], int], points: Array
) -> tuple[dict[str, str], dict[int, str]]:
    """Return each camera's observations of points (n, 3) as in images.txt, and the points' tracks by number.

    A camera's images show the same points at the same pixels. Points with a track are seen by two cameras.
    """
    visible = {name: visible_pixels(lens, points) + _HALF_PIXEL for name, lens in lenses.items()}
    both = np.flatnonzero(np.sum([np.isfinite(pixels[:, 0]) for pixels in visible.values()], axis=0) >= 2)
    both = both[:: 1 + len(both) // _MAX_TRACKS]
    seen, tracks = {}, {int(index) + 1: "" for index in both}
    for name, pixels in visible.items():
        images = [number for (camera, _), number in ids.items() if camera == name]
        own = both[np.isfinite(pixels[both, 0])]
        seen[name] = " ".join(f"{_numbers(pixels[index].tolist())} {index + 1}" for index in own)
        for order, index in enumerate(own):
            tracks[int(index) + 1] += "".join(f" {number} {order}" for number in images)
    return seen, tracks


def _model(camera: CameraCalibration) -> tuple[str, list[float]]:
    """Return COLMAP's camera model with this distortion, and its parameters in COLMAP's order."""
    pinhole = [camera.fx, camera.fy, camera.cx + _HALF_PIXEL, camera.cy + _HALF_PIXEL]
    if camera.is_fisheye:
        return "OPENCV_FISHEYE", [*pinhole, *distortion_of(camera).tolist()]
    *tangential, k3 = distortion_of(camera).tolist()
    if k3:
        return "FULL_OPENCV", [*pinhole, *tangential, k3, 0.0, 0.0, 0.0]
    return ("OPENCV", [*pinhole, *tangential]) if any(tangential) else ("PINHOLE", pinhole)


def _from_reference(reference: CameraCalibration, camera: CameraCalibration) -> tuple[Array, Array]:
    """Return rotation and translation from the reference camera's coordinates to a camera's."""
    rotation = rotation_of(camera) @ rotation_of(reference).T
    return rotation, translation_of(camera) - rotation @ translation_of(reference)


def _pose(rotation: Array, translation: Array) -> str:
    return _numbers([*quaternion(rotation), *np.asarray(translation)])


def _numbers(values: list[float]) -> str:
    return " ".join(repr(float(value)) for value in values)


EXPORTER = Exporter(
    write=write,
    help="images and rig_config.json; a model where calibrated",
    program="COLMAP",
    one_instant=True,
    calibration="optional",
    fisheyes=True,
    uncalibrated="the session has no calibration: COLMAP finds the cameras itself",
)
