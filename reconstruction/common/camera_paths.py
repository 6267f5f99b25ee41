"""Paths of a virtual camera: through a rig's cameras, or around what they look at."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.session.files.untrusted_files import read_input
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.camera_order import order_on_arc
from reconstruction.common.geometry import Array, View, look_along

RING_DEG = 100.0
"""Angle around the subject from which on cameras stand around it, and a path follows them."""
MARGIN = 0.95
"""Fraction of the rig's extent that a path uses; beyond, too little was seen."""
ZOOM = 1.06
"""How much narrower a path's view is than the cameras', to hide the borders."""


class Frame(NamedTuple):
    """The part of a sphere around the subject on which a rig's cameras stand.

    Places are angles to the right and down, radians, from `ahead`, the direction in which the rig looks.
    """

    subject: Array
    right: Array
    down: Array
    ahead: Array
    distance: float
    middle: tuple[float, float]
    half: tuple[float, float]
    """Half of the extent in both angles, within which there is something to show."""
    spot: tuple[float, float]
    """Place of the subject in the picture, as fractions of its width and height."""
    scale: float
    """Focal length in picture widths, for a subject at distance 1."""

    def place(self, across: float, down: float) -> Array:
        """Return a place (3,), from -1 to 1 across and down the frame."""
        a, b = self.middle[0] + across * self.half[0], self.middle[1] + down * self.half[1]
        outwards = (
            np.sin(a) * np.cos(b) * self.right + np.sin(b) * self.down - np.cos(a) * np.cos(b) * self.ahead
        )
        return np.asarray(self.subject + self.distance * outwards)

    def view(self, place: Array, width: int, height: int) -> View:
        """Return the upright view from a place in which the subject keeps its spot and size."""
        ahead = self.subject - place
        focal = self.scale * width * float(np.linalg.norm(ahead))
        ahead = ahead / np.linalg.norm(ahead)
        rotation = look_along(ahead, self.down)
        x, y = np.array(self.spot) * (width, height) - 0.5
        matrix = np.array([[focal, 0, x], [0, focal, y], [0, 0, 1.0]])
        return View(width, height, matrix, np.zeros(5), rotation, -rotation @ place)


def frame_of(views: Mapping[str, View], subject: Array) -> Frame:
    """Return the frame of a rig's cameras around a subject."""
    centres = np.array([view.centre for view in views.values()])
    down = np.mean([view.rotation[1] for view in views.values()], axis=0)
    ahead = np.mean([view.axis for view in views.values()], axis=0)
    if np.linalg.norm(ahead) < 0.2:  # all around
        ahead = next(iter(views.values())).axis
    right = np.cross(down, ahead)
    right /= np.linalg.norm(right)
    down /= np.linalg.norm(down)
    ahead = np.cross(right, down)
    rays = centres - subject
    ranges = np.linalg.norm(rays, axis=1)
    across = np.arctan2(rays @ right, -(rays @ ahead))
    below = np.arcsin(np.clip(rays @ down / ranges, -1, 1))
    half = [MARGIN * float(np.ptp(axis)) / 2 for axis in (across, below)]
    scales, spots = [], []
    for view, distance in zip(views.values(), ranges, strict=True):
        at = view.rotation @ subject + view.translation
        scales.append(view.focal / view.width / distance)
        spots.append((view.project(at.reshape(1, 3))[0] + 0.5) / (view.width, view.height))
    x, y = np.clip(np.mean(spots, axis=0), 0.3, 0.7).tolist()
    return Frame(
        subject,
        right,
        down,
        ahead,
        float(np.median(ranges)),
        (float(across.min() + across.max()) / 2, float(below.min() + below.max()) / 2),
        (half[0], max(half[1], 0.2 * half[0])),
        (x, y),
        ZOOM * float(np.median(scales)),
    )


def swing(views: Mapping[str, View], subject: Array, frames: int) -> list[View]:
    """Return views from one end of the rig to the other and back, as an endless film."""
    along = (1 - np.cos(2 * np.pi * np.arange(frames) / frames)) / 2
    return _along(views, subject, along, 2 * along - 1, np.zeros(frames))


def orbit(views: Mapping[str, View], subject: Array, frames: int) -> list[View]:
    """Return views on an ellipse within the rig, or once along all cameras that stand around the subject."""
    fractions = np.arange(frames) / frames
    angles = 2 * np.pi * fractions
    return _along(views, subject, fractions, 0.8 * np.cos(angles), 0.8 * np.sin(angles))


def stand_still(views: Mapping[str, View], subject: Array, frames: int) -> list[View]:
    """Return equal views from the middle of the rig."""
    frame, first = frame_of(views, subject), next(iter(views.values()))
    return [frame.view(frame.place(0, 0), first.width, first.height)] * frames


def _along(views: Mapping[str, View], subject: Array, along: Array, across: Array, down: Array) -> list[View]:
    """Return views through cameras that stand around the subject, else at these places of the rig's frame.

    `along` runs from 0 to 1 through the cameras, `across` and `down` from -1 to 1.
    """
    frame, first = frame_of(views, subject), next(iter(views.values()))
    places = (
        _through_cameras(views, along)
        if _stand_around(views, subject)
        else [frame.place(*place) for place in zip(across, down, strict=True)]
    )
    return [frame.view(place, first.width, first.height) for place in places]


def read_path(path: Path) -> list[View]:
    """Read a path: the cameras of a calibration.json in their order, or nerfstudio's camera path.

    Raises BadInputError for anything else.
    """
    data = read_input(path)
    try:
        if b'"camera_path"' in data:
            return _nerfstudio_views(json.loads(data))
        cameras = msgspec.json.decode(data, type=Calibration).cameras.values()
        views = [View.from_calibration(camera, camera.width, camera.height).undistorted for camera in cameras]
        if not views:
            raise ValueError("no cameras")
    except (ValueError, LookupError, TypeError, msgspec.MsgspecError) as error:
        raise BadInputError(
            f"{path} is no path of a camera: {error}",
            hint="give a calibration.json with a camera for each picture, or nerfstudio's camera path",
        ) from error
    return views


def _nerfstudio_views(content: Mapping[str, object]) -> list[View]:
    width, height = int(content["render_width"]), int(content["render_height"])  # type: ignore[call-overload]
    views = []
    for camera in content["camera_path"]:  # type: ignore[attr-defined]
        pose = np.array(camera["camera_to_world"], np.float64).reshape(4, 4)
        focal = height / 2 / np.tan(np.radians(float(camera["fov"])) / 2)
        rotation = (pose[:3, :3] * [1.0, -1.0, -1.0]).T
        matrix = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1.0]])
        views.append(View(width, height, matrix, np.zeros(5), rotation, -rotation @ pose[:3, 3]))
    return views


def order_of_views(views: Mapping[str, View]) -> tuple[str, ...]:
    """Return the cameras' names along their arc; see `order_on_arc`."""
    return order_on_arc({name: view.to_calibration() for name, view in views.items()})


def _stand_around(views: Mapping[str, View], subject: Array) -> bool:
    rays = np.array([view.centre - subject for view in views.values()])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    return bool((rays @ rays.T).min() < np.cos(np.radians(RING_DEG)))


def _through_cameras(views: Mapping[str, View], along: Array) -> list[Array]:
    """Return places on a smooth path through the cameras in order; `along` runs from 0 to 1."""
    centres = np.array([views[name].centre for name in order_of_views(views)])
    at = along * (len(centres) - 1)
    left = np.clip(at.astype(int), 0, len(centres) - 2)
    before, after = np.maximum(left - 1, 0), np.minimum(left + 2, len(centres) - 1)
    t = (at - left)[:, None]
    p = [centres[k] for k in (before, left, left + 1, after)]
    # Catmull-Rom.
    places = 0.5 * (
        2 * p[1] + (p[2] - p[0]) * t + (2 * p[0] - 5 * p[1] + 4 * p[2] - p[3]) * t**2
        + (3 * p[1] - p[0] - 3 * p[2] + p[3]) * t**3
    )  # fmt: skip
    return list(places)
