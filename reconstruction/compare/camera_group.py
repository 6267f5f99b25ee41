"""The cameras that a multi-view study compares conditions with, and the depths that they see."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from capture_app.errors import BadInputError
from reconstruction.depth.depth_range import find_depth_range
from reconstruction.multiview.source_views import (
    choose_reference_view,
    choose_source_views,
    guess_depths,
    sample_depths,
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
    depth_range: tuple[float, float] = (0.0, 0.0)
    """Nearest and farthest depth, in the calibration's unit."""
    left_out: Mapping[str, str] = field(default_factory=dict)

    @property
    def sample_depths(self) -> tuple[float, float, float]:
        """The nearest, a middle and the farthest depth."""
        return sample_depths(*self.depth_range)


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
        depth_range = find_depth_range(images, choose_source_views(views, guess_depths(views)))
    except BadInputError as error:
        raise ValueError(error.what) from error
    depths = sample_depths(*depth_range)
    sources = choose_source_views(views, depths)
    for camera in images:
        if len(sources[camera]) < 2:
            left_out[camera] = "overlaps too little with any two others"
            del views[camera]
    _require_cameras(len(views), left_out)
    reference = choose_reference_view(views, depths)
    nearest = [c for c in sources[reference] if c in views][: MAX_CAMERAS - 1]
    cameras = tuple(c for c in names if c == reference or c in nearest)
    for camera in views:
        if camera not in cameras:
            left_out[camera] = f"{MAX_CAMERAS} cameras are enough to compare conditions"
    _require_cameras(len(cameras), left_out)
    return CameraGroup(reference, cameras, depth_range, left_out)


def _require_cameras(count: int, left_out: Mapping[str, str]) -> None:
    if count < MIN_CAMERAS:
        text = [f"it takes {MIN_CAMERAS} cameras with overlapping views"]
        for reason in dict.fromkeys(left_out.values()):
            text.append(f"{', '.join(c for c, its in left_out.items() if its == reason)}: {reason}")
        raise ValueError("; ".join(text))
