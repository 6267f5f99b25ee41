"""Checks of a calibration by shared points: its quality, whether it is still valid, and which camera moved.

A camera that turned along the line to its neighbour violates no epipolar constraint of a pair. The check
therefore also uses points that three cameras see.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import cv2
import numpy as np
from msgspec import Struct

from capture_app.common.errors import BadInputError
from capture_app.session.format.lens import triangulate_rays
from reconstruction.common.geometry import Array, View, angle_deg, angles_deg
from reconstruction.pairs import CELLS, MIN_MATCHES, Features, grid_cells, match_features, size_above_features

SharedPoints = Mapping[tuple[str, str], tuple[Array, Array]]
"""For pairs of cameras, pixels (n, 2) of the same points in the first and in the second."""
INLIER_PX = 4.0
"""Maximum reprojection error of an inlier; beyond it the match or the calibration is wrong."""
MAX_REPROJECTION_PX = 2.0
MIN_ANGLE_DEG = 0.3
NEIGHBOURS = 4
"""Number of nearest cameras with a similar viewing direction that each camera is compared with."""
MAX_AXIS_ANGLE_DEG = 45.0
"""Maximum angle between viewing axes; beyond it features match by chance only."""
MIN_PAIR_POINTS = 50
"""Minimum common points of two cameras that are compared, and of all cameras to judge a calibration."""
MIN_TRACKS = 15
"""Minimum common points of three cameras that are compared."""
RANSAC_PX = 2.0
MIN_INLIER_FRACTION = 0.4
"""Minimum fraction of a pair's matches that one epipolar geometry must explain, or a calibration."""
INCONSISTENT_PX = 1.0
"""Standard deviation of reprojection errors above which cameras are inconsistent. Like REFUSED_PX, it
applies to images at most MAX_SIDE_PX wide."""
REFUSED_PX = 3.0
"""Shift of a camera beyond which depth is worthless: the rows of a pair no longer match."""
MIN_BLAME = 0.3
"""Minimum fraction of inconsistent pairs and triples of a moved camera; below it the matches are wrong."""
MIN_RAY_ANGLE_DEG = 1.0
FAR_PX = 1000.0
MAX_RELATIVE_DISTANCE = 1e6
"""Distance of points at infinity, large compared to any rig."""


Groups = dict[tuple[str, ...], Array]
"""Pixels (k, n, 2) of points that all k cameras see, by the cameras' names."""
OTHER_RIG = 0.5, 0.05
"""Minimum fraction of inconsistent pairs and triples with another rig's calibration, and the minimum error
as a fraction of the image width."""
TYPICAL_WIDTH = 640
"""Image width below which the limit shrinks: exchanged cameras then differ by fewer pixels."""
MAX_SUSPECTS = 12
"""Maximum number of inconsistent cameras among which exchanged pairs are searched for."""


class MovedCamera(Struct, frozen=True, kw_only=True):
    """A camera whose pose differs from its calibration; several names mean one of these."""

    cameras: tuple[str, ...]
    shift_px: float
    """Median distance of its points from where the calibration puts them."""

    def __str__(self) -> str:
        """Describe the camera as in `cam02 moved: 4.0 px`."""
        return f"{' or '.join(self.cameras)} moved: {self.shift_px:.1f} px"


class RigCheck(Struct, frozen=True, kw_only=True):
    """Result of checking a calibration against points at rest."""

    points: int
    """Number of points that two or more cameras share."""
    error_px: float | None
    """Median over all pairs and triples of cameras, as a standard deviation; None without shared points."""
    unchecked: tuple[str, ...]
    """Cameras that share too few points with others."""
    moved: tuple[MovedCamera, ...]
    holds: bool
    """Whether no camera moved so far that depth is worthless."""

    def __str__(self) -> str:
        """Describe the moved cameras."""
        return ", ".join(map(str, self.moved)) or "no camera has moved"


@dataclass(frozen=True)
class _Group:
    """Two or three cameras, their pixels (k, n, 2) of common points, and the reprojection errors of these."""

    cameras: tuple[str, ...]
    pixels: Array
    errors: Array
    """Reprojection errors (k, n), px."""

    @property
    def deviation(self) -> float:
        """Median standard deviation of the pixels: k views have 2k - 3 more measurements than unknowns."""
        freedom = 2 * len(self.cameras) - 3
        return float(np.median(np.sqrt((self.errors**2).sum(0) / freedom)))


def check_rig(views: Mapping[str, View], features: Mapping[str, Features]) -> RigCheck:
    """Check the views against features at rest, all of one instant."""
    pixels = _shared_points(views, features)
    groups = [_measured(views, names, at) for names, at in pixels.items()]
    limit = _refused_px(views)
    shared = {name for group in groups for name in group.cameras}
    guilty = _blamed(groups, limit * INCONSISTENT_PX / REFUSED_PX)
    moved = [MovedCamera(cameras=names, shift_px=_shift(views, names, groups, guilty)) for names in guilty]
    return RigCheck(
        points=sum(at.shape[1] for names, at in pixels.items() if len(names) == 2),
        error_px=float(np.median([group.deviation for group in groups])) if groups else None,
        unchecked=tuple(name for name in views if name not in shared),
        moved=tuple(moved),
        holds=all(camera.shift_px <= limit for camera in moved),
    )


def _shared_points(views: Mapping[str, View], features: Mapping[str, Features]) -> Groups:
    """Return the pixels of points that pairs and triples of neighbours share."""
    matches = {pair: _sure_matches(views, pair, features) for pair in _neighbours(views, features)}
    matches = {pair: at for pair, at in matches.items() if len(at[0]) >= MIN_PAIR_POINTS}
    return {pair: np.stack(at) for pair, at in matches.items()} | _triples(matches)


def _refused_px(views: Mapping[str, View]) -> float:
    return REFUSED_PX * max((size_above_features(v.width, v.height) for v in views.values()), default=1.0)


def _neighbours(views: Mapping[str, View], features: Mapping[str, Features]) -> list[tuple[str, str]]:
    views = {name: view for name, view in views.items() if name in features}
    found = set()
    for name, view in views.items():
        others = [
            other
            for other in views
            if other != name and angle_deg(view.axis, views[other].axis) < MAX_AXIS_ANGLE_DEG
        ]
        others.sort(key=lambda other: float(np.linalg.norm(views[other].centre - view.centre)))
        found |= {tuple(sorted((name, other))) for other in others[:NEIGHBOURS]}
    return sorted((a, b) for a, b in found)


def _sure_matches(
    views: Mapping[str, View], pair: tuple[str, str], features: Mapping[str, Features]
) -> tuple[Array, Array]:
    """Return the matches that fit one epipolar geometry, independent of the calibration."""
    at_a, at_b = match_features(features[pair[0]], features[pair[1]])
    sure = consistent_matches((views[pair[0]], views[pair[1]]), at_a, at_b)
    return (at_a[:0], at_b[:0]) if sure is None else (at_a[sure], at_b[sure])


def consistent_matches(views: tuple[View, View], at_a: Array, at_b: Array) -> Array | None:
    """Return which matches (n, 2) px fit one epipolar geometry, independent of the views' poses (bool).

    None if there are too few, or if most of them fit none.
    """
    if len(at_a) < MIN_MATCHES:
        return None
    flat_a, flat_b = (view.rays(at)[:, :2] * view.focal for view, at in zip(views, (at_a, at_b), strict=True))
    matrix, inliers = cv2.findFundamentalMat(flat_a, flat_b, cv2.USAC_MAGSAC, RANSAC_PX, 0.999, 5000)
    if matrix is None or inliers is None or inliers.mean() < MIN_INLIER_FRACTION:
        return None
    return np.asarray(inliers.ravel().astype(bool))


def _triples(matches: Mapping[tuple[str, str], tuple[Array, Array]]) -> dict[tuple[str, ...], Array]:
    """Return, for three cameras, the pixels (3, n, 2) of points on which all three pairs agree."""
    partner = {
        pair: {tuple(x): tuple(y) for x, y in zip(a.tolist(), b.tolist(), strict=True)}
        for pair, (a, b) in matches.items()
    }
    found: dict[tuple[str, ...], Array] = {}
    for a, b, c in combinations(sorted({name for pair in matches for name in pair}), 3):
        if not {(a, b), (b, c), (a, c)} <= partner.keys():
            continue
        tracks = [
            (x, y, z)
            for x, y in partner[a, b].items()
            if (z := partner[a, c].get(x)) is not None and partner[b, c].get(y) == z
        ]
        if len(tracks) >= MIN_TRACKS:
            found[a, b, c] = np.array(tracks).transpose(1, 0, 2)
    return found


def _measured(views: Mapping[str, View], names: Sequence[str], pixels: Array) -> _Group:
    points = triangulate([views[name] for name in names], pixels)
    errors = [reprojection_errors(views[name], points, at) for name, at in zip(names, pixels, strict=True)]
    return _Group(tuple(names), pixels, np.stack(errors))


def triangulate(views: Sequence[View], pixels: Array) -> Array:
    """Triangulate points (n, 3) in the rig's frame from pixels (k, n, 2) of k views (linear method).

    The method is Hartley and Sturm's. If the rays diverge, so that a point would be behind a view, the point
    is put far away between them.
    """
    rays = [view.rays(at) for view, at in zip(views, pixels, strict=True)]
    poses = [np.column_stack([view.rotation, view.translation]) for view in views]
    found = triangulate_rays((ray[:, :2], pose) for ray, pose in zip(rays, poses, strict=True))
    scale = np.where(np.abs(found[:, 3]) < 1e-12, 1e-12, found[:, 3])
    points = found[:, :3] / scale[:, None]
    behind = np.any([points @ view.rotation[2] + view.translation[2] <= 0 for view in views], axis=0)
    units = (ray / np.linalg.norm(ray, axis=1, keepdims=True) for ray in rays)
    towards = sum(unit @ view.rotation for unit, view in zip(units, views, strict=True))
    points[behind] = MAX_RELATIVE_DISTANCE * np.asarray(towards)[behind]
    return np.asarray(points)


def reprojection_errors(view: View, points: Array, at: Array) -> Array:
    """Return the distances (n,), px, of projected rig points (n, 3) from pixels (n, 2); at most FAR_PX."""
    there = points @ view.rotation.T + view.translation
    front = there[:, 2] > 1e-9
    distance = np.linalg.norm(view.project(np.where(front[:, None], there, (0.0, 0.0, 1.0))) - at, axis=1)
    return np.asarray(np.where(front, distance, FAR_PX).clip(0, FAR_PX))


def _blamed(groups: Sequence[_Group], limit: float) -> list[tuple[str, ...]]:
    """Return few moved cameras that explain all inconsistencies, found greedily.

    An entry with several names means one of these cameras: the points cannot tell which.
    """
    blamed: list[tuple[str, ...]] = []
    left = list(groups)
    while bad := [group for group in left if group.deviation > limit]:
        names = sorted({name for group in bad for name in group.cameras})
        counts = {
            name: (
                sum(name in group.cameras for group in bad) / sum(name in group.cameras for group in left),
                sum(name in group.cameras for group in bad),
            )
            for name in names
        }
        worst_counts = max(counts.values())
        if worst_counts[0] < MIN_BLAME:
            break
        worst = tuple(name for name in names if counts[name] == worst_counts)
        blamed.append(worst)
        left = [group for group in left if not set(worst) & set(group.cameras)]
    return blamed


def _shift(
    views: Mapping[str, View],
    names: tuple[str, ...],
    groups: Sequence[_Group],
    blamed: Sequence[tuple[str, ...]],
) -> float:
    """Return a camera's median distance from points that others triangulate, else from epipolar lines, px."""
    (name, *unsure) = names
    guilty = {camera for group in blamed for camera in group}
    distances = []
    for group in () if unsure else groups:
        others = [i for i, camera in enumerate(group.cameras) if camera != name]
        if len(group.cameras) - len(others) != 1 or len(others) != 2:
            continue
        if {group.cameras[i] for i in others} & guilty:
            continue
        first, second = (views[group.cameras[i]] for i in others)
        points = triangulate([first, second], group.pixels[others])
        rays = points - first.centre, points - second.centre
        clear = angles_deg(*rays) > MIN_RAY_ANGLE_DEG
        at = group.pixels[group.cameras.index(name)]
        if clear.any():
            distances.append(reprojection_errors(views[name], points[clear], at[clear]))
    if distances and len(found := np.concatenate(distances)) >= MIN_TRACKS:
        return float(np.median(found))
    concerned = [group for group in groups if set(names) & set(group.cameras)]
    return max(float(np.median(group.errors.sum(0))) for group in concerned)


Views = dict[str, View]


def plainly_fits(views: Views, features: Mapping[str, Features]) -> bool:
    """Return whether every camera's features, including wrong matches, fit those of a neighbour."""
    matched = {(a, b): match_features(features[a], features[b]) for a, b in _neighbours(views, features)}
    groups: Groups = {pair: np.stack(at) for pair, at in matched.items() if len(at[0]) >= MIN_PAIR_POINTS}
    asked = {name for pair in groups for name in pair}
    return asked == views.keys() and not _odd(views, groups, _mixed_up_px(views))


def find_mixups(views: Views, features: Mapping[str, Features]) -> list[tuple[str, str]]:
    """Describe upside-down images and exchanged cameras, or that the calibration is another rig's.

    Each step assumes the fault whose correction removes most inconsistencies. These faults are reported only
    if together they remove all of them. Each is named with the camera at fault; "" if it is not one alone.
    """
    groups = _shared_points(views, features)
    limit = _mixed_up_px(views)
    now, faults = dict(views), []
    left = _odd(now, groups, limit)
    while left:
        names = sorted({name for group in left for name in group})
        changes = [({name: upside_down(now[name])}, _turned(name, views)) for name in names]
        for a, b in combinations(names if len(names) <= MAX_SUSPECTS else (), 2):
            changes.append(({a: now[b], b: now[a]}, ("", f"the calibrations of {a} and {b} are exchanged")))
        tried = [_odd(now | changed, groups, limit) for changed, _ in changes]
        best = min(range(len(tried)), key=lambda k: len(tried[k]))
        if len(tried[best]) >= len(left):
            break
        left = tried[best]
        now |= changes[best][0]
        faults.append(changes[best][1])
    if not left:
        return faults
    min_fraction, min_error = OTHER_RIG
    odd = _odd(views, groups, max(_refused_px(views), min_error * max(view.width for view in views.values())))
    if len(odd) <= min_fraction * len(groups):
        return []
    text = (
        f"it does not fit the pictures: {len(odd)} of {len(groups)} groups of neighbouring cameras "
        "contradict each other (is it another rig's, or were its cameras moved?)"
    )
    return [("", text)]


def _mixed_up_px(views: Views) -> float:
    return _refused_px(views) * min(
        1.0, max((view.width for view in views.values()), default=0) / TYPICAL_WIDTH
    )


def _odd(views: Views, groups: Groups, limit: float) -> list[tuple[str, ...]]:
    return [names for names, at in groups.items() if _measured(views, names, at).deviation > limit]


def _turned(name: str, views: Views) -> tuple[str, str]:
    # With two cameras it cannot be decided which one is wrong.
    pair = len(views) == 2
    who = " or ".join(views) if pair else name
    return "" if pair else name, f"the pictures of {who} are upside down against the calibration"


def upside_down(view: View) -> View:
    """Return the view of the same camera with its images rotated by 180 degrees."""
    rotation_180 = np.diag([-1.0, -1.0, 1.0])
    matrix = view.matrix.copy()
    matrix[:2, 2] = (view.width - 1, view.height - 1) - matrix[:2, 2]
    distortion = view.distortion * np.array([1, 1, -1, -1, 1])
    return replace(
        view,
        matrix=matrix,
        distortion=distortion,
        rotation=rotation_180 @ view.rotation,
        translation=rotation_180 @ view.translation,
    )


class CalibrationQuality(Struct, frozen=True, kw_only=True):
    """Quality from points that camera pairs share; an inlier's reprojection error is below `INLIER_PX`."""

    points: int
    inlier_share: float
    reprojection_error_px: float | None
    """Median over the inliers of the larger of a point's two errors."""
    triangulation_angle_deg: float | None
    """Median angle between an inlier's two rays."""
    coverage: dict[str, float]
    """By camera, the fraction of an 8 x 6 grid's cells that contain an inlier."""


def judge_calibration(views: Mapping[str, View], shared: SharedPoints) -> CalibrationQuality:
    """Judge a calibration by the reprojection errors of triangulated points (Hartley and Sturm, linear)."""
    errors, angles, fits = [], [], []
    cells: dict[str, set[tuple[int, int]]] = {name: set() for name in views}
    for (a, b), (at_a, at_b) in shared.items():
        if a not in views or b not in views or len(at_a) < MIN_MATCHES:
            continue
        error, angle = _triangulate(views[a], views[b], at_a, at_b)
        good = error < INLIER_PX
        errors.append(error[good])
        angles.append(angle[good])
        fits.append(good)
        for name, at in ((a, at_a), (b, at_b)):
            cells[name] |= grid_cells(at[good], views[name].width, views[name].height)
    every = np.concatenate(fits) if fits else np.zeros(0, bool)
    return CalibrationQuality(
        points=len(every),
        inlier_share=float(every.mean()) if len(every) else 0.0,
        reprojection_error_px=float(np.median(np.concatenate(errors))) if every.any() else None,
        triangulation_angle_deg=float(np.median(np.concatenate(angles))) if every.any() else None,
        coverage={name: len(found) / CELLS for name, found in cells.items()},
    )


def refuse_bad_calibration(quality: CalibrationQuality, cameras: int, advice: str = "") -> None:
    """Raise BadInputError with the reason if a rig's calibration is not fit for measurements.

    `advice` is a further hint.
    """
    error, angle = quality.reprojection_error_px, quality.triangulation_angle_deg
    share = f"{100 * quality.inlier_share:.0f} %"
    unjudged = why = ""
    if 2 * len(quality.coverage) < cameras:
        why = f"it covers only {len(quality.coverage)} of {cameras} cameras"
    elif error is None or angle is None:
        unjudged = "no two of its cameras see enough of the same points"
    elif quality.points < MIN_PAIR_POINTS:
        unjudged = f"its cameras share only {quality.points} points; {MIN_PAIR_POINTS} are needed"
    elif quality.inlier_share < MIN_INLIER_FRACTION:
        why = f"only {share} of the shared points have a reprojection error below {INLIER_PX:g} px"
    elif error > MAX_REPROJECTION_PX:
        why = f"the median reprojection error is {error:.1f} px, above {MAX_REPROJECTION_PX:g} px"
    elif angle < MIN_ANGLE_DEG:
        why = f"the median triangulation angle is {angle:.2f} degrees, too small to measure depth"
    if unjudged:
        raise BadInputError(
            f"this calibration cannot be judged: {unjudged}",
            hint="record a board, held where neighbouring cameras both see it" + advice,
        )
    if why:
        raise BadInputError(
            f"this calibration is not good enough: {why}",
            hint="record a board from several places, in front of this rig, and calibrate again" + advice,
        )


def _triangulate(a: View, b: View, at_a: Array, at_b: Array) -> tuple[Array, Array]:
    """Return each point's larger reprojection error, px, and the angle between its rays, degrees."""
    points = triangulate((a, b), np.stack((at_a, at_b)))
    error = np.maximum(reprojection_errors(a, points, at_a), reprojection_errors(b, points, at_b))
    return error, angles_deg(a.rays(at_a) @ a.rotation, b.rays(at_b) @ b.rotation)
