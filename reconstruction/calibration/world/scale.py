"""The scale of a calibration: from two points a known distance apart, or from a board in the scene."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import msgspec
import numpy as np

from capture_app.board.charuco import MIN_CORNERS
from capture_app.board.detector import Board
from capture_app.errors import BadInputError
from capture_app.session.format.calibration import Calibration
from reconstruction.calibration.boards.rig_from_boards import BoardCorners, corners_by_moment
from reconstruction.calibration.consistency import reprojection_errors, triangulate
from reconstruction.common.geometry import Array, View, angle_deg
from reconstruction.pairs.features import size_above_features

MAX_MARK_ERROR_PX = 8.0
"""In pictures MAX_SIDE_PX wide or narrower: marks are set by hand, on one thing in all pictures."""
MIN_ANGLE_DEG = 1.0
MAX_BOARD_ERROR_PX = 3.0


Marks = Mapping[str, tuple[tuple[float, float], tuple[float, float]]]
"""Two points' pixels (x, y) in each of two cameras or more."""


@dataclass(frozen=True)
class KnownDistance:
    """Two points that are marked, and how far apart they are in metres."""

    marks: Marks
    metres: float


def scaled(calibration: Calibration, factor: float, how: str) -> Calibration:
    """The calibration in metres: every translation times `factor`."""
    cameras = {
        name: msgspec.structs.replace(
            camera, translation=tuple(factor * value for value in camera.translation)
        )
        for name, camera in calibration.cameras.items()
    }
    source = f"{calibration.source}; scale from {how}"
    return msgspec.structs.replace(calibration, cameras=cameras, unit="m", source=source)


def metres_per_unit(views: Mapping[str, View], known: KnownDistance) -> float:
    """Metres in a unit of the views, from two points that are marked in their pictures.

    Raises:
        BadInputError: a camera is unknown, or its marks are not of the same things as the others'.
    """
    first, second = marked_points(views, known.marks)
    return known.metres / float(np.linalg.norm(first - second))


def marked_points(views: Mapping[str, View], marks: Marks) -> Array:
    """The two points (2, 3) of the rig that are marked in the views' pictures.

    Raises:
        BadInputError: a camera is unknown, or its marks are not of the same things as the others'.
    """
    for name in marks:
        if name not in views:
            raise BadInputError(
                f"--mark {name}=... cannot be used: {name} is not among the calibrated cameras",
                hint=f"mark the points in {' or '.join(views)}",
            )
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
                    f"the {which} mark in {name} is {error:.0f} px from where the others' marks have it",
                    hint="mark the same two things, in the same order, in every camera",
                )
    for end in ends:
        if max(angle_deg(end - a.centre, end - b.centre) for a, b in combinations(seen, 2)) < MIN_ANGLE_DEG:
            raise BadInputError(
                f"{' and '.join(marks)} see the marks from nearly the same place",
                hint="mark them in cameras that stand further apart",
            )
    return ends


def metres_per_unit_by_board(
    views: Mapping[str, View], board: Board, corners: BoardCorners
) -> tuple[float, int]:
    """Metres in a unit of the views from a board that two cameras see, and at how many moments they do.

    Raises:
        BadInputError: no two cameras see enough of it at one moment.
    """
    factors = []
    for seen in corners_by_moment(corners).values():
        factors += [
            factor
            for a, b in combinations((name for name in seen if name in views), 2)
            if (factor := _board_factor((views[a], views[b]), board, (seen[a], seen[b]))) is not None
        ]
    if not factors:
        raise BadInputError(
            "no two cameras see the board well enough at one instant to tell the scale from it",
            hint="lay it where two cameras see it large; check --board and --square-mm",
        )
    return float(np.median(factors)), len(factors)


def _board_factor(
    views: tuple[View, View], board: Board, corners: tuple[dict[int, Array], dict[int, Array]]
) -> float | None:
    both = sorted(corners[0].keys() & corners[1].keys())
    if len(both) < MIN_CORNERS:
        return None
    pixels = np.array([[found[number] for number in both] for found in corners], float)
    points = triangulate(views, pixels)
    if angle_deg(*(points.mean(0) - view.centre for view in views)) < MIN_ANGLE_DEG:
        return None
    worst = max(
        float(np.median(reprojection_errors(v, points, at))) for v, at in zip(views, pixels, strict=True)
    )
    if worst > MAX_BOARD_ERROR_PX * size_above_features(views[0].width, views[0].height):
        return None
    places = board.places[both].astype(float)
    spreads = (float(np.linalg.norm(of - of.mean(0))) for of in (places, points))
    true, found = spreads
    return true / found if found > 0 else None
