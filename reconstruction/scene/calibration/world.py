"""Scale, ground and vertical of a calibration, from a board or from two marked points.

The world has z up and its origin on the ground. With a board, x points to its right and y to its top. With
two points one above the other, y points ahead of the first camera.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import msgspec
import numpy as np

from capture_app.board.boards import MIN_CORNERS
from capture_app.board.detector import Board, Corners
from capture_app.common.errors import BadInputError
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.camera_labels import require_camera
from reconstruction.common.geometry import Array, View, angle_deg
from reconstruction.scene.calibration.board_bundle import rig_from_board
from reconstruction.scene.calibration.board_calibration import BoardCorners, corners_by_moment
from reconstruction.scene.calibration.consistency import MIN_RAY_ANGLE_DEG, reprojection_errors, triangulate
from reconstruction.scene.conditions import evenly_spaced
from reconstruction.scene.pairs import size_above_features

MAX_MARK_ERROR_PX = 8.0
"""Maximum error of a mark in images at most MAX_SIDE_PX wide; marks are set by hand."""

Marks = Mapping[str, tuple[tuple[float, float], tuple[float, float]]]
"""Pixels (x, y) of two points in each of two or more cameras."""
MAX_ROTATION_DEG = 3.0
"""Maximum rotation of a static board between two moments."""
MAX_RESIDUAL_FRACTION = 0.05
"""Maximum RMS residual of a flat board, as a fraction of its size."""


def marked_points(views: Mapping[str, View], marks: Marks, labels: Mapping[str, str] | None = None) -> Array:
    """Triangulate the two marked points, (2, 3) in the rig's frame; `labels` is what people call the cameras.

    Raises:
        BadInputError: a camera is unknown, or its marks do not match those in the other images.
    """
    known = {name: (labels or {}).get(name, name) for name in views}
    marks = {require_camera(text, known, "--mark"): at for text, at in marks.items()}
    if len(marks) < 2:
        raise BadInputError(
            "a distance needs its two ends marked in two cameras", hint="--mark CAMERA=X1,Y1,X2,Y2 for each"
        )
    seen = [views[name] for name in marks]
    pixels = np.array(list(marks.values()), float)
    ends = triangulate(seen, pixels)
    for name, view, at in zip(marks, seen, pixels, strict=True):
        limit = MAX_MARK_ERROR_PX * size_above_features(view.width, view.height)
        for which, error in zip(("first", "second"), reprojection_errors(view, ends, at), strict=True):
            if error > limit:
                raise BadInputError(
                    f"the {which} mark in {known[name]} is {error:.0f} px from where the others' marks have"
                    " it",
                    hint="mark the same two things, in the same order, in every camera",
                )
    for end in ends:
        if (
            max(angle_deg(end - a.centre, end - b.centre) for a, b in combinations(seen, 2))
            < MIN_RAY_ANGLE_DEG
        ):
            raise BadInputError(
                f"{' and '.join(known[name] for name in marks)} see the marks from nearly the same place",
                hint="mark them in cameras that stand further apart",
            )
    return ends


@dataclass(frozen=True)
class World:
    """Map x_world = rotation @ (scale * x_rig) + translation; 3x3, (3,), scale in metres per rig unit."""

    rotation: Array
    translation: Array
    scale: float = 1.0


def in_world(calibration: Calibration, world: World, unit: str, how: str) -> Calibration:
    """Transform a calibration into world coordinates in `unit`; `how` is appended to its source."""
    cameras = {}
    for name, camera in calibration.cameras.items():
        rotation = np.array(camera.rotation) @ world.rotation.T
        translation = world.scale * np.array(camera.translation) - rotation @ world.translation
        cameras[name] = msgspec.structs.replace(
            camera,
            rotation=tuple(tuple(float(v) for v in row) for row in rotation),
            translation=tuple(float(v) for v in translation),
        )
    return msgspec.structs.replace(
        calibration, cameras=cameras, unit=unit, source=f"{calibration.source}; {how}"
    )


def world_of_marks(views: Mapping[str, View], marks: Marks, labels: Mapping[str, str] | None = None) -> World:
    """Return the world with its origin at the first of two marked points and z towards the second.

    Raises:
        BadInputError: as `marked_points`.
    """
    foot, head = marked_points(views, marks, labels)
    up = (head - foot) / np.linalg.norm(head - foot)
    first = next(iter(views.values()))
    # If it looks straight up or down, the top of its picture is ahead.
    ahead = first.axis if abs(up @ first.axis) <= 0.99 else -first.rotation[1]
    ahead = ahead - (up @ ahead) * up
    ahead /= np.linalg.norm(ahead)
    rotation = np.array([np.cross(ahead, up), ahead, up])
    return World(rotation, -rotation @ foot)


def metres_per_unit_by_board(
    views: Mapping[str, View], board: Board, corners: BoardCorners
) -> tuple[float, int]:
    """Return the metres per unit of the views from a board that two cameras see, and the number of moments.

    Raises:
        BadInputError: no two cameras see enough of the board at one moment.
    """
    fits = _fits(views, board, corners, metric=False)
    return float(np.median([fit.scale for fit in fits])), len(fits)


def world_of_board(
    views: Mapping[str, View], board: Board, corners: BoardCorners, *, metric: bool
) -> tuple[World, int]:
    """Return the world of a board on the ground, and the number of moments at which it was used.

    Points seen by two or more cameras give the board's pose, and the length of a unit unless the views are
    `metric`. If there are none, one camera is enough for a metric rig.

    Raises:
        BadInputError: too little of the board is seen, it moves, or it is seen from below.
    """
    fits = _fits(views, board, corners, metric=metric)
    if any(angle_deg(fit.rotation[2], fits[0].rotation[2]) > MAX_ROTATION_DEG for fit in fits):
        raise BadInputError(
            "the board on the ground moves", hint="record it again with the board lying still"
        )
    world = fits[len(fits) // 2]
    centres = np.array([view.centre for view in views.values()])
    if np.median(world.scale * centres @ world.rotation[2] + world.translation[2]) < 0:
        raise BadInputError("the board on the ground is seen from below", hint="lay it face up")
    return world, len(fits)


def _fits(views: Mapping[str, View], board: Board, corners: BoardCorners, *, metric: bool) -> list[World]:
    """Return the world of the board at each moment at which it is seen well enough."""
    moments = evenly_spaced(list(corners_by_moment(corners).values()), 20)
    fits = [fit for seen in moments if (fit := _fit_shared(views, board, seen, metric)) is not None]
    if not fits and metric:
        fits = [fit for seen in moments if (fit := _fit_alone(views, board, seen)) is not None]
    if not fits:
        raise BadInputError(
            "no two cameras see the board well enough at one instant",
            hint="lay it where two cameras see it large; check --board and --square-mm",
        )
    return fits


def _fit_shared(
    views: Mapping[str, View], board: Board, seen: Mapping[str, Corners], metric: bool
) -> World | None:
    known = [name for name in seen if name in views]
    by_number = {number: [n for n in known if number in seen[n]] for name in known for number in seen[name]}
    shared = {number: names for number, names in by_number.items() if len(names) > 1}
    if len(shared) < MIN_CORNERS:
        return None
    points = np.concatenate(
        [
            triangulate([views[name] for name in names], np.array([[seen[name][number]] for name in names]))
            for number, names in shared.items()
        ]
    )
    places = board.places[list(shared)].astype(float)
    scale, rotation, translation = _similarity(places, points, rigid=metric)
    residual = np.sqrt(((scale * places @ rotation.T + translation - points) ** 2).sum(1).mean())
    if residual > MAX_RESIDUAL_FRACTION * scale * float(np.linalg.norm(np.ptp(places, axis=0))):
        return None
    return _world_of(rotation, translation, scale)


def _fit_alone(views: Mapping[str, View], board: Board, seen: Mapping[str, Corners]) -> World | None:
    name = max((name for name in seen if name in views), key=lambda name: len(seen[name]), default="")
    if not name or len(seen[name]) < MIN_CORNERS:
        return None
    numbers = sorted(seen[name])
    pixels = np.array([seen[name][number] for number in numbers], float)
    return _world_of(*rig_from_board(views[name], board.places[numbers].astype(float), pixels), 1.0)


def _world_of(rotation: Array, translation: Array, scale: float) -> World:
    """Return the world of a board that is at `scale * rotation @ place + translation` in the rig."""
    # From the board's axes (x right, y down, z into the floor) to the world's.
    into = np.diag([1.0, -1.0, -1.0]) @ rotation.T
    return World(into, -into @ translation / scale, 1 / scale)


def _similarity(places: Array, points: Array, *, rigid: bool) -> tuple[float, Array, Array]:
    """Fit scale, rotation and translation that map places (n, 3) onto points (n, 3) (Umeyama 1991)."""
    at, to = places - places.mean(0), points - points.mean(0)
    left, values, right = np.linalg.svd(to.T @ at)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    rotation = (left * signs) @ right
    scale = 1.0 if rigid else float((values * signs).sum() / (at**2).sum())
    return scale, rotation, points.mean(0) - scale * rotation @ places.mean(0)
