"""COLMAP's calibrations: a sparse model, or a `rig_config.json` with the poses and lenses of its sensors.

Conventions of colmap.github.io/format.html, cameras.html and rigs.html: cam_from_world as quaternion
(w, x, y, z) and translation, camera axes as OpenCV's, the first pixel's centre at (0.5, 0.5). A model has no
scale of its own.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from capture_app.errors import BadInputError
from capture_app.session.importers.calibrations.camera_views import Array, View, Views, from_quaternion
from capture_app.session.importers.calibrations.colmap_files import ColmapModel, Pose, read_model
from capture_app.session.importers.calibrations.image_poses import camera_of, views_of_images

_HALF_PIXEL = 0.5
_ARBITRARY = "arbitrary"
_LENSES: dict[str, tuple[int, Callable[..., tuple[float, ...]]]] = {
    "SIMPLE_PINHOLE": (3, lambda f, x, y: (f, f, x, y)),
    "PINHOLE": (4, lambda *all_: all_),
    "SIMPLE_RADIAL": (4, lambda f, x, y, k: (f, f, x, y, k)),
    "RADIAL": (5, lambda f, x, y, k1, k2: (f, f, x, y, k1, k2)),
    "OPENCV": (8, lambda *all_: all_),
    "FULL_OPENCV": (12, lambda *all_: all_),
}
"""By model, how many parameters it has, and they as fx, fy, cx, cy and OpenCV's distortion."""


def read_colmap(folder: Path, cameras: Sequence[str]) -> Views:
    """The cameras of a model, in its world; an image is of the camera that its path names.

    Where a rig's images have several poses, it is the rig's sensors that stand still against each other: then
    the first sensor is the origin. Raises BadInputError for what is broken, not perspective, or moves.
    """
    model = read_model(folder)
    if not model.images:
        raise BadInputError(f"{folder} has no images", hint="is the model empty?")
    try:
        views = views_of_images(str(folder), _images(model, cameras), _hint(model))
    except BadInputError:
        if len(model.rigs) != 1 or len(model.rigs[0]) < 2:
            raise
        views = _of_rig(model, model.rigs[0], cameras)
    return Views(views, f"COLMAP model {'/'.join(folder.parts[-2:])}", assumed_unit=_ARBITRARY)


def views_of_rig_config(path: Path, content: Sequence[Any]) -> Views:
    """The cameras of a decoded rig_config.json; a camera's name is the last folder of its image_prefix.

    Raises BadInputError where a sensor has no pose or no lens, or where it describes several rigs.
    """
    if len(content) != 1:
        raise BadInputError(f"{path} describes {len(content)} rigs", hint="keep the one of the recording")
    views = {}
    for sensor in content[0]["cameras"]:
        prefix = str(sensor.get("image_prefix", ""))
        name = (PurePosixPath(prefix).parts or ("",))[-1]
        where = f"{path}: camera {name}"
        reference = sensor.get("ref_sensor", False)
        rotation, translation = (sensor.get(f"cam_from_rig_{part}") for part in ("rotation", "translation"))
        if reference:
            rotation, translation = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        if rotation is None or translation is None:
            raise BadInputError(f"{where} has no cam_from_rig", hint="give COLMAP's model, sparse/0")
        if "camera_model_name" not in sensor or "camera_params" not in sensor:
            raise BadInputError(f"{where} has no camera_params", hint="give COLMAP's model, sparse/0")
        lens = _lens(where, sensor["camera_model_name"], sensor["camera_params"])
        views[name] = _view(where, lens, (*rotation, *translation), None)
    return Views(views, path.name, assumed_unit=_ARBITRARY)


def _hint(model: ColmapModel) -> str:
    joined = "a rig stands still: give a model of one instant, or one made with rig_config.json"
    return joined if len(model.rigs) != 1 else "a rig stands still"


def _images(model: ColmapModel, cameras: Sequence[str]) -> list[tuple[str, View]]:
    return [
        (camera_of(image.name, cameras), _of_model(model, image.name, image.camera, image.pose))
        for image in model.images
    ]


def _of_rig(model: ColmapModel, sensors: Mapping[int, Pose], cameras: Sequence[str]) -> dict[str, View]:
    names = {image.camera: camera_of(image.name, cameras) for image in model.images}
    return {
        names[key]: _of_model(model, names[key], key, pose) for key, pose in sensors.items() if key in names
    }


def _of_model(model: ColmapModel, name: str, key: int, pose: Pose) -> View:
    where = f"{model.folder}: {name}"
    camera = model.cameras.get(key)
    if camera is None:
        raise BadInputError(f"{where} is of camera {key}, which the model lacks")
    return _view(where, _lens(where, camera.model, camera.parameters), pose, (camera.width, camera.height))


def _lens(where: str, model: str, parameters: Sequence[float]) -> tuple[float, ...]:
    if model not in _LENSES:
        raise BadInputError(
            f"{where} has COLMAP's camera model {model}", hint=f"supported are {', '.join(_LENSES)}"
        )
    count, arrange = _LENSES[model]
    if len(parameters) != count:
        raise BadInputError(f"{where} has {len(parameters)} parameters; {model} has {count}")
    return arrange(*map(float, parameters))


def _view(where: str, lens: tuple[float, ...], pose: Sequence[float], size: tuple[int, int] | None) -> View:
    fx, fy, x, y, *distortion = lens
    distorted: Array = np.array([*distortion, *[0.0] * (5 - len(distortion))])
    return View(
        matrix=np.array([[fx, 0, x - _HALF_PIXEL], [0, fy, y - _HALF_PIXEL], [0, 0, 1]]),
        distortion=distorted,
        rotation=from_quaternion(where, pose[:4]),
        translation=np.array(pose[4:7], np.float64),
        size=size,
    )
