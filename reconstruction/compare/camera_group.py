"""The cameras that a multi-view study compares conditions with, and the depths that they see."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from capture_app.errors import BadInputError
from reconstruction.depth.coarse_scene import CoarseScene, find_coarse_scene
from reconstruction.multiview.source_views import (
    choose_reference_view,
    choose_source_views,
)
from reconstruction.multiview.undistorted_session import UndistortedSession

MIN_CAMERAS = 3
MAX_CAMERAS = 5
"""More cameras make better clouds, but say no more about timing; each takes as long as the first."""
MAX_TRIES = 4
"""Instants tried to find one at which every camera has a usable picture."""


@dataclass(frozen=True)
class CameraGroup:
    """Cameras with overlapping views around a reference in their middle, and why others are left out."""

    reference: str = ""
    cameras: tuple[str, ...] = ()
    scene: CoarseScene = field(default_factory=lambda: CoarseScene({}, {}))
    """What a first look found of the scene."""
    left_out: Mapping[str, str] = field(default_factory=dict)


def choose_camera_group(shots: UndistortedSession, middle: int) -> CameraGroup:
    """Choose the cameras from synchronized pictures around the instant `middle`.

    Raises:
        ValueError: fewer than `MIN_CAMERAS` have overlapping views.
    """
    dataset = shots.dataset
    names, instants = dataset.cameras, range(len(dataset.instants_ns))
    counts = {k: sum(dataset.has_image(c, k) for c in names) for k in instants}
    fullest = sorted(instants, key=lambda k: (-counts[k], abs(k - middle)))[:MAX_TRIES]
    best = max(fullest, key=lambda k: sum(shots.usable(c, k) for c in names))
    left_out = {c: problem for c in names if (problem := shots.problem(c, best))}
    images = {c: shots.image(c, best).calibrated for c in names if c not in left_out}
    _require_cameras(len(images), left_out)
    views = {camera: image.view for camera, image in images.items()}
    try:
        scene = find_coarse_scene(images)
    except BadInputError as error:
        raise ValueError(error.what) from error
    sources = choose_source_views({c: view for c, view in views.items() if c in scene.points}, scene.points)
    for camera in images:
        if len(sources.get(camera, ())) < 2:
            left_out[camera] = "overlaps too little with any two others"
            del views[camera]
    _require_cameras(len(views), left_out)
    reference = choose_reference_view(views, scene.points)
    nearest = [c for c in sources[reference] if c in views][: MAX_CAMERAS - 1]
    cameras = tuple(c for c in names if c == reference or c in nearest)
    for camera in views:
        if camera not in cameras:
            left_out[camera] = f"{MAX_CAMERAS} cameras are enough to compare conditions"
    _require_cameras(len(cameras), left_out)
    return CameraGroup(reference, cameras, scene, left_out)


def _require_cameras(count: int, left_out: Mapping[str, str]) -> None:
    if count < MIN_CAMERAS:
        text = [f"it takes {MIN_CAMERAS} cameras with overlapping views"]
        for reason in dict.fromkeys(left_out.values()):
            text.append(f"{', '.join(c for c, its in left_out.items() if its == reason)}: {reason}")
        raise ValueError("; ".join(text))
