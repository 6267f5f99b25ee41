"""The ground and the upward direction of a calibration: from a board on the floor, or from two marked points.

The world gets z upwards and its origin on the ground. By a board, x is to its right and y to its top; by two
points one above the other, y is ahead of the first camera.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import msgspec
import numpy as np

from capture_app.board.charuco import MIN_CORNERS
from capture_app.board.detector import Board, Corners
from capture_app.errors import BadInputError
from capture_app.session.format.calibration import Calibration
from reconstruction.calibration.boards.rig_from_boards import BoardCorners, corners_by_moment
from reconstruction.calibration.consistency import triangulate
from reconstruction.calibration.world.scale import Marks, marked_points
from reconstruction.common.geometry import Array, View, angle_deg
from reconstruction.session.frame_offset import evenly_spread

MAX_MOMENTS = 20
MAX_TURN_DEG = 3.0
"""Between two moments, of a board that lies still."""
MAX_MISFIT_SHARE = 0.05
"""Of the board's size, root mean square: more, and it is no flat board that these cameras see."""
WORLD_FROM_BOARD = np.diag([1.0, -1.0, -1.0])
"""A board's x and y are right and down as one looks at it, its z into the floor."""


@dataclass(frozen=True)
class World:
    """x_world = rotation @ (scale * x_rig) + translation; 3x3, (3,), metres in a unit of the rig."""

    rotation: Array
    translation: Array
    scale: float = 1.0


def in_world(calibration: Calibration, world: World, how: str) -> Calibration:
    """The calibration in other coordinates; in metres, where these are scaled."""
    cameras = {}
    for name, camera in calibration.cameras.items():
        rotation = np.array(camera.rotation) @ world.rotation.T
        translation = world.scale * np.array(camera.translation) - rotation @ world.translation
        cameras[name] = msgspec.structs.replace(
            camera,
            rotation=tuple(tuple(float(v) for v in row) for row in rotation),
            translation=tuple(float(v) for v in translation),
        )
    unit = calibration.unit if world.scale == 1.0 else "m"
    source = f"{calibration.source}; z up, ground by {how}"
    return msgspec.structs.replace(calibration, cameras=cameras, unit=unit, source=source)


def world_of_marks(views: Mapping[str, View], marks: Marks) -> World:
    """The world whose origin is the first of two marked points, and whose z leads to the second.

    Raises:
        BadInputError: as `marked_points`.
    """
    foot, head = marked_points(views, marks)
    up = (head - foot) / np.linalg.norm(head - foot)
    first = next(iter(views.values()))
    ahead = first.axis
    if abs(up @ ahead) > 0.99:  # it looks straight up or down: the top of its picture is ahead
        ahead = -first.rotation[1]
    ahead = ahead - (up @ ahead) * up
    ahead /= np.linalg.norm(ahead)
    rotation = np.array([np.cross(ahead, up), ahead, up])
    return World(rotation, -rotation @ foot)


def world_of_board(
    views: Mapping[str, View], board: Board, corners: BoardCorners, *, metric: bool
) -> tuple[World, int]:
    """The world of a board that lies on the ground, and the number of moments that it was seen at.

    Points that two cameras or more see tell where it lies, and how long a unit is unless the views are
    `metric`; a rig in metres also knows it from one camera.

    Raises:
        BadInputError: too little of it is seen, it does not lie still, or it is seen from below.
    """
    moments = evenly_spread(list(corners_by_moment(corners).values()), MAX_MOMENTS)
    fits = [fit for seen in moments if (fit := _fit_shared(views, board, seen, metric)) is not None]
    if not fits and metric:
        fits = [fit for seen in moments if (fit := _fit_alone(views, board, seen)) is not None]
    if not fits:
        raise BadInputError(
            "no two cameras see the board on the ground well enough at one instant",
            hint="lay it where two cameras see it large; check --board and --square-mm",
        )
    normal = fits[0].rotation[2]
    if any(angle_deg(fit.rotation[2], normal) > MAX_TURN_DEG for fit in fits):
        raise BadInputError(
            "the board on the ground does not lie still", hint="--ground takes a session in which it does"
        )
    world = fits[len(fits) // 2]
    heights = [
        float(world.rotation[2] @ (world.scale * v.centre) + world.translation[2]) for v in views.values()
    ]
    if np.median(heights) < 0:
        raise BadInputError("the board on the ground is seen from below", hint="lay it face up")
    return world, len(fits)


def _fit_shared(
    views: Mapping[str, View], board: Board, seen: Mapping[str, Corners], metric: bool
) -> World | None:
    by_number: dict[int, list[str]] = {}
    for name, found in seen.items():
        for number in found if name in views else ():
            by_number.setdefault(number, []).append(name)
    shared = {number: names for number, names in by_number.items() if len(names) > 1}
    if len(shared) < MIN_CORNERS:
        return None
    points = np.array(
        [
            triangulate([views[name] for name in names], np.array([[seen[name][number]] for name in names]))[
                0
            ]
            for number, names in shared.items()
        ]
    )
    places = board.places[list(shared)].astype(float)
    scale, rotation, translation = _similarity(places, points, rigid=metric)
    misfit = np.sqrt(((scale * places @ rotation.T + translation - points) ** 2).sum(1).mean())
    if misfit > MAX_MISFIT_SHARE * scale * float(np.linalg.norm(np.ptp(places, axis=0))):
        return None
    return _world_of(rotation, translation, scale)


def _fit_alone(views: Mapping[str, View], board: Board, seen: Mapping[str, Corners]) -> World | None:
    known = {name: found for name, found in seen.items() if name in views and len(found) >= MIN_CORNERS}
    if not known:
        return None
    name = max(known, key=lambda one: len(known[one]))
    view, numbers = views[name], sorted(known[name])
    pixels = np.array([known[name][number] for number in numbers], float)
    good, turn, move = cv2.solvePnP(board.places[numbers].astype(float), pixels, view.matrix, view.distortion)
    if not good:
        return None
    rotation = view.rotation.T @ cv2.Rodrigues(turn)[0]
    return _world_of(rotation, view.rotation.T @ (move.ravel() - view.translation), 1.0)


def _world_of(rotation: Array, translation: Array, scale: float) -> World:
    """The world of a board that is at `scale * rotation @ place + translation` in the rig."""
    into = WORLD_FROM_BOARD @ rotation.T
    return World(into, -into @ translation / scale, 1 / scale)


def _similarity(places: Array, points: Array, *, rigid: bool) -> tuple[float, Array, Array]:
    """Scale, rotation and translation that bring places (n, 3) nearest to points (n, 3) (Umeyama 1991)."""
    at, to = places - places.mean(0), points - points.mean(0)
    left, values, right = np.linalg.svd(to.T @ at)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    rotation = (left * signs) @ right
    scale = 1.0 if rigid else float((values * signs).sum() / (at**2).sum())
    return scale, rotation, points.mean(0) - scale * rotation @ places.mean(0)
