"""Checks of a calibration by shared points: its quality, whether it is still valid, and which camera moved.

A camera that turned along the line to its neighbour violates no epipolar constraint of a pair. The check
therefore also uses points that three cameras see.
"""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import chain, combinations

import cv2
import numpy as np
from msgspec import Struct

from capture_app.common.errors import BadInputError
from capture_app.common.grouping import grouped
from capture_app.session.format.calibration import LensKnowledge
from capture_app.session.format.lens import triangulate_rays
from reconstruction.common.geometry import Array, View, angle_deg, angles_deg, epipolar_errors_px
from reconstruction.common.templates import render_sentences
from reconstruction.scene.pairs import (
    GRID,
    MIN_MATCHES,
    Features,
    grid_cells,
    match_features,
    size_above_features,
)

SharedPoints = Mapping[tuple[str, str], tuple[Array, Array]]
"""For pairs of cameras, pixels (n, 2) of the same points in the first and in the second."""
INLIER_PX = 4.0
"""Maximum reprojection error of an inlier; beyond it the match or the calibration is wrong."""
MAX_REPROJECTION_PX = 2.0
"""Maximum reprojection error of a match."""
MIN_ANGLE_DEG = 0.3
"""Minimum angle between the rays of a match."""
MAX_AXIS_ANGLE_DEG = 45.0
"""Maximum angle between viewing axes; beyond it features match by chance only."""
MIN_PAIR_POINTS = 50
"""Minimum common points of two cameras that are compared, and of all cameras to judge a calibration."""
MIN_TRACKS = 15
"""Minimum common points of three cameras that are compared."""
RANSAC_PX = 2.0
"""Maximum epipolar error of an inlier."""
PLANE_PX = 3.0
"""Maximum distance of a match from where a plane's homography puts it; noise and a lens' distortion."""
MIN_BESIDE_PLANE, MIN_BESIDE_FRACTION = 30, 0.1
"""Minimum number and fraction of matches that are not in the plane of most."""
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
"""Minimum angle between the rays of a track, or to a mark."""


Groups = dict[tuple[str, ...], Array]
"""Pixels (k, n, 2) of points that all k cameras see, by the cameras' names."""
OTHER_RIG = 0.5, 0.05
"""Minimum fraction of inconsistent pairs and triples with another rig's calibration, and the minimum error
as a fraction of the image width."""
INACCURATE_PX, UNMEASURED_PX = 0.3, 2.0
"""Misfit of points at rest from which depth is inaccurate, and from which it is not called measured.

Exact rigs have 0.05 to 0.15; of jumper with one to four cameras turned by 0.5 to 2 px, 92 % have a camera of
over 0.3."""
ROTATION_PX = 0.5
"""Turn for which the error of two cameras' depth is said, px."""
TYPICAL_WIDTH = 640
"""Image width below which the limit shrinks: exchanged cameras then differ by fewer pixels."""
SURE_LENSES, ROUGH_LENSES = 0.02, 0.1
"""Maximum relative 95 % errors of focal lengths by which depth can be said to be no better, as it is right
within 2 %, and by which it can be judged at all."""
MAX_BELIEVED = 0.08
"""Maximum relative 95 % error of focal lengths at which the images are believed against given ones."""
GIVEN_ERROR = 0.04
"""Relative error that given lenses are granted: data sheets and EXIF are rounded."""


class MovedCamera(Struct, frozen=True, kw_only=True):
    """A camera whose pose differs from its calibration; several names mean one of these."""

    cameras: tuple[str, ...]
    shift_px: float
    """Median distance of its points from where the calibration puts them."""

    def __str__(self) -> str:
        """Describe the camera as in `cam02 moved: 4.0 px`."""
        return f"{' or '.join(self.cameras)} moved: {self.shift_px:.1f} px"


class CalibrationCheck(Struct, frozen=True, kw_only=True):
    """Result of checking a calibration against points at rest."""

    points: int
    """Number of points that two or more cameras share."""
    error_px: float | None
    """Median over all pairs and triples of cameras, as a standard deviation; None without shared points."""
    errors_px: dict[str, float]
    """By camera, the median over its pairs and triples; the depth of the others suffers less by its turn."""
    unchecked: tuple[str, ...]
    """Cameras that share too few points with others."""
    moved: tuple[MovedCamera, ...]
    """Cameras that do not fit, unless focal lengths explain it."""
    by_lenses: str = ""
    """What the points say against the focal lengths, with both figures; empty without a contradiction."""
    confirms_lenses: bool = False
    """Whether the points would show other focal lengths, and do not."""
    holds: bool
    """Whether no moved camera and no wrong focal length makes depth worthless."""

    def __str__(self) -> str:
        """Describe what the lenses explain, else the moved cameras."""
        return self.by_lenses or ", ".join(map(str, self.moved)) or "no camera has moved"


def describe_residual(
    error_px: float | None,
    points: int,
    remedy: str = "calibrate the rig again, or try --refine",
    expected: float | None = None,
    expected_range: tuple[float, float] | None = None,
    errors_px: Mapping[str, float] | None = None,
) -> str:
    """Describe how well points at rest fit the calibration that depth rests on.

    `expected`: fraction of the pixels that are probably right, with its 95 % interval; None = unknown, then
    that of a simulated rig. `errors_px`: misfit by camera.
    """
    return render_sentences(
        "misfit.txt",
        "reconstruction.scene",
        error_px=error_px,
        errors_px=errors_px or {"": error_px},
        points=points,
        remedy=remedy,
        expected=expected,
        expected_range=expected_range,
        inaccurate_px=INACCURATE_PX,
        unmeasured_px=UNMEASURED_PX,
    )


def turn_error(first: View, second: View, depth: Array) -> float | None:
    """Return the relative error of the median of `depth`, in the first view, by a turn that no point shows.

    A turn of `ROTATION_PX` about the axis across the line between two cameras moves all points along their
    epipolar lines. None without depth.
    """
    known = depth[depth > 0]
    between = first.rotation @ (second.centre - first.centre)
    across = float(np.hypot(between[0], between[1]) * first.matrix[0, 0])
    return ROTATION_PX * float(np.median(known)) / across if known.size and across > 0 else None


def describe_sideways_error(error: float) -> str:
    """Describe what depth from two cameras may be off by, unseen, as `turn_error` returns it."""
    return (
        "two cameras do not show a turn sideways: "
        f"{ROTATION_PX} px of it is {100 * error:.1f} % of depth here"
    )


def lens_knowledge(
    errors: Sequence[float], why: str = "too few points", *, is_guess: bool = False
) -> LensKnowledge:
    """Return how well focal lengths are known by their relative 95 % errors; `why`: if there are none."""
    if errors:
        why = f"off by up to {100 * min(errors):.2g} to {100 * max(errors):.2g} % (95 %)"
    worst = max(errors, default=math.inf)
    return LensKnowledge(
        level="well" if worst <= SURE_LENSES else "roughly" if worst <= ROUGH_LENSES else "not",
        why=why,
        is_guess=is_guess,
    )


def no_measurement(lenses: LensKnowledge) -> str:
    """Return the warning about depth by lenses that are not known well; empty if they are."""
    what = "inaccurate" if lenses.level == "roughly" else "not a measurement"
    warning = f"{what}: {lenses.doubt(rough=True)}; calibrate with a board that reaches the corners"
    return f"warning: this depth is {warning}" if lenses.level != "well" else ""


def check_rig(
    views: Mapping[str, View], features: Mapping[str, Features], lenses: LensKnowledge | None = None
) -> CalibrationCheck:
    """Check the views against features at rest, all of one instant; `lenses` is what is known of theirs."""
    groups = _shared_points(views, features)
    errors = {names: _errors_px(views, names, at) for names, at in groups.items()}
    deviations = {names: _deviation_px(own_errors) for names, own_errors in errors.items()}
    limit = _refused_px(views)
    own = {
        name: float(np.median([px for names, px in deviations.items() if name in names]))
        for name in sorted(set().union(*groups))
    }
    guilty = _blamed(deviations, limit * INCONSISTENT_PX / REFUSED_PX)
    moved = [
        MovedCamera(cameras=names, shift_px=_shift(views, names, groups, errors, guilty)) for names in guilty
    ]
    worst = max(moved, key=lambda camera: camera.shift_px, default=None)
    odd_px, known = limit * INACCURATE_PX / REFUSED_PX, lenses or LensKnowledge()
    judged = [
        judge_focal_lengths(views, groups, names, odd_px)
        for names in ((*own,), *((name,) for name in own if own[name] > odd_px))
        if names
    ]
    by_lenses = next((text for text, _ in judged if text), "")
    holds = not by_lenses and (worst is None or worst.shift_px <= limit)
    # What doubtful focal lengths move at least, a quarter of the width from the middle.
    min_px = {"well": 0.0, "roughly": SURE_LENSES, "not": ROUGH_LENSES}[known.level] / 4
    if worst and not by_lenses and worst.shift_px <= min_px * min(views[n].width for n in worst.cameras):
        by_lenses = (
            f"points at rest miss {' or '.join(worst.cameras)} by {worst.shift_px:.1f} px, "
            f"with {known.doubt(rough=True)}"
        )
    return CalibrationCheck(
        points=sum(at.shape[1] for names, at in groups.items() if len(names) == 2),
        error_px=float(np.median(list(deviations.values()))) if groups else None,
        errors_px=own,
        unchecked=tuple(name for name in views if name not in own),
        moved=() if by_lenses else tuple(moved),
        by_lenses=by_lenses,
        confirms_lenses=bool(judged) and judged[0][1],
        holds=holds,
    )


def judge_focal_lengths(
    views: Mapping[str, View], groups: Groups, names: tuple[str, ...], well_px: float
) -> tuple[str, bool]:
    """Return what contradicts focal lengths, with both figures, and whether points at rest confirm them.

    One scale of the focal lengths of `names` is fitted to points that pairs share: Gauss-Newton of Sampson's
    distances with Cauchy's weights; poses stay. Its error is robust to residuals that are correlated within a
    quarter of a pair's picture (Liang and Zeger, 1986), such as those of a turned camera. Points contradict
    what they do not fit if they fit another scale within `well_px`, in the median.
    """
    pairs = {pair: at for pair, at in groups.items() if len(pair) == 2 and not set(names).isdisjoint(pair)}
    quarters = [(at[0] > np.median(at[0], axis=0)) @ (1, 2) + 4 * n for n, at in enumerate(pairs.values())]

    def distances(shift: float) -> Array:
        scaled = {**views, **{name: views[name].magnified(math.exp(shift)) for name in names}}
        return np.concatenate([epipolar_errors_px(scaled[a], scaled[b], *at) for (a, b), at in pairs.items()])

    shift, given, small = 0.0, distances(0.0), 1e-4
    for _ in range(8):
        residuals = distances(shift)
        slopes = (distances(shift + small) - residuals) / small
        weights = 1 / (1 + (residuals / (3 * np.median(np.abs(residuals)) + 0.1)) ** 2)
        information = max(float((weights * slopes**2).sum()), 1e-12)
        step = -float((weights * slopes * residuals).sum()) / information
        shift += min(max(step, -0.1), 0.1)
    scores = np.bincount(np.concatenate(quarters), weights * slopes * residuals)
    # Besides, the points' own noise, of at least a hundredth of a pixel: few quarters may agree by chance.
    noise = float((weights * residuals**2).sum() / weights.sum()) + 1e-4
    error = 2 * math.sqrt(float((scores**2).sum()) + noise * information) / information
    is_sure, is_other = error <= MAX_BELIEVED, abs(shift) > error + GIVEN_ERROR
    fits_px, misses_px = (float(np.median(np.abs(px))) for px in (residuals, given))
    given_px, found_px = (views[names[0]].focal * math.exp(change) for change in (0.0, shift))
    text = (
        f"the calibration gives {names[0]} a focal length of {given_px:.0f} px, and points at rest say "
        f"{found_px:.0f} ± {max(1.0, found_px * error):.0f} px"
        f"{'; the others are off by the same factor' if len(names) > 1 else ''}"
    )
    is_wrong = is_sure and is_other and fits_px <= min(misses_px / 2, well_px)
    return text if is_wrong else "", is_sure and not is_other


def _shared_points(views: Mapping[str, View], features: Mapping[str, Features]) -> Groups:
    """Return the pixels of points that pairs and triples of neighbours share.

    Matches must fit one epipolar geometry, independent of the calibration.
    """
    matches: Groups = {}
    for a, b in _neighbours(views, features):
        at = match_features(features[a], features[b])
        sure = consistent_matches((views[a], views[b]), *at)
        if sure is not None and sure.sum() >= MIN_PAIR_POINTS:
            matches[a, b] = np.stack(at)[:, sure]
    return matches | _triples(matches)


Track = dict[str, Array]
"""The pixel (2,) of one point in each camera that sees it."""


def find_tracks(views: Mapping[str, View], features: Mapping[str, Features]) -> list[Track]:
    """Return the points that two or more cameras share, by their matches in pairs; see `_shared_points`."""
    root: dict[tuple[str, float, float], tuple[str, float, float]] = {}

    def find(place: tuple[str, float, float]) -> tuple[str, float, float]:
        while root.setdefault(place, place) != place:
            place = root[place]
        return place

    for names, at in _shared_points(views, features).items():
        if len(names) == 2:
            for first, second in at.transpose(1, 0, 2).tolist():
                root[find((names[0], *first))] = find((names[1], *second))
    groups = grouped((find(place), place) for place in list(root))
    # Two places in one camera: at least one match is wrong.
    whole = [group for group in groups.values() if 1 < len({name for name, *_ in group}) == len(group)]
    return [{name: np.array(at) for name, *at in group} for group in whole]


def _refused_px(views: Mapping[str, View]) -> float:
    return REFUSED_PX * max((size_above_features(v.width, v.height) for v in views.values()), default=1.0)


def _neighbours(views: Mapping[str, View], features: Mapping[str, Features]) -> list[tuple[str, str]]:
    views = {name: view for name, view in views.items() if name in features}
    chosen = set()
    for name, view in views.items():
        others = sorted(
            (
                other
                for other in views
                if other != name and angle_deg(view.axis, views[other].axis) < MAX_AXIS_ANGLE_DEG
            ),
            key=lambda other: float(np.linalg.norm(views[other].centre - view.centre)),
        )
        # The four nearest cameras with a similar viewing direction.
        chosen |= {tuple(sorted((name, other))) for other in others[:4]}
    return sorted((a, b) for a, b in chosen)


def consistent_matches(views: tuple[View, View], at_a: Array, at_b: Array) -> Array | None:
    """Return which matches (n, 2) px fit one epipolar geometry, independent of the views' poses (bool).

    None if there are too few, or if most of them fit none.
    """
    if len(at_a) < MIN_MATCHES:
        return None
    flat_a, flat_b = (view.rays(at)[:, :2] * view.focal for view, at in zip(views, (at_a, at_b), strict=True))
    try:
        matrix, inliers = cv2.findFundamentalMat(flat_a, flat_b, cv2.USAC_MAGSAC, RANSAC_PX, 0.999, 5000)
    except cv2.error:
        # OpenCV 5 fails an assertion where no sample of the matches gives a geometry.
        return None
    if matrix is None or inliers is None or inliers.mean() < MIN_INLIER_FRACTION:
        return None
    return np.asarray(inliers.ravel().astype(bool))


def fit_one_plane(at_a: Array, at_b: Array) -> bool:
    """Return whether matches (n, 2) px determine no geometry: one plane, or one turn, explains nearly all.

    So do points on a wall, points far away, and those of a camera that only turned. They fit many poses and
    focal lengths equally well (Hartley and Zisserman, 11.6).
    """
    if len(at_a) < MIN_MATCHES:
        return True
    _, sure = cv2.findFundamentalMat(at_a, at_b, cv2.FM_RANSAC, RANSAC_PX, 0.999, 5000)
    _, in_plane = cv2.findHomography(at_a, at_b, cv2.RANSAC, PLANE_PX)
    if sure is None or in_plane is None:
        return True
    beside = (sure.ravel()[: len(at_a)] > in_plane.ravel()).sum()
    return bool(beside < max(MIN_BESIDE_PLANE, MIN_BESIDE_FRACTION * int(sure.sum())))


def _triples(matches: Groups) -> Groups:
    """Return, for three cameras, the pixels (3, n, 2) of points on which all three pairs agree."""
    partner = {
        pair: {tuple(x): tuple(y) for x, y in zip(a.tolist(), b.tolist(), strict=True)}
        for pair, (a, b) in matches.items()
    }
    triples: Groups = {}
    for a, b, c in combinations(sorted({name for pair in matches for name in pair}), 3):
        if not {(a, b), (b, c), (a, c)} <= partner.keys():
            continue
        tracks = [
            (x, y, z)
            for x, y in partner[a, b].items()
            if (z := partner[a, c].get(x)) is not None and partner[b, c].get(y) == z
        ]
        if len(tracks) >= MIN_TRACKS:
            triples[a, b, c] = np.array(tracks).transpose(1, 0, 2)
    return triples


def _errors_px(views: Mapping[str, View], names: Sequence[str], pixels: Array) -> Array:
    """Return the reprojection errors (k, n) of the points, px, that k cameras see at pixels (k, n, 2)."""
    points = triangulate([views[name] for name in names], pixels)
    return np.stack([reprojection_errors(views[n], points, at) for n, at in zip(names, pixels, strict=True)])


def _deviation_px(errors: Array) -> float:
    """Return the median standard deviation of pixels whose reprojection errors (k, n) are given.

    k views have 2k - 3 more measurements than unknowns.
    """
    return float(np.median(np.sqrt((errors**2).sum(0) / (2 * len(errors) - 3))))


def triangulate(views: Sequence[View], pixels: Array) -> Array:
    """Triangulate points (n, 3) in the rig's frame from pixels (k, n, 2) of k views (linear method).

    The method is Hartley and Sturm's. If the rays diverge, so that a point would be behind a view, the point
    is put far away between them.
    """
    rays = [view.rays(at) for view, at in zip(views, pixels, strict=True)]
    poses = [np.column_stack([view.rotation, view.translation]) for view in views]
    homogeneous = triangulate_rays((ray[:, :2], pose) for ray, pose in zip(rays, poses, strict=True))
    points = homogeneous[:, :3] / np.where(np.abs(homogeneous[:, 3:]) < 1e-12, 1e-12, homogeneous[:, 3:])
    behind = np.any([points @ view.rotation[2] + view.translation[2] <= 0 for view in views], axis=0)
    units = (ray / np.linalg.norm(ray, axis=1, keepdims=True) for ray in rays)
    towards = sum(unit @ view.rotation for unit, view in zip(units, views, strict=True))
    # Far compared to any rig.
    points[behind] = 1e6 * np.asarray(towards)[behind]
    return np.asarray(points)


def reprojection_errors(view: View, points: Array, at: Array) -> Array:
    """Return the distances (n,), px, of projected rig points (n, 3) from pixels (n, 2); at most 1000.

    A point behind the view is as far.
    """
    far_px = 1000.0
    there = points @ view.rotation.T + view.translation
    front = there[:, 2] > 1e-9
    distance = np.linalg.norm(view.project(np.where(front[:, None], there, (0.0, 0.0, 1.0))) - at, axis=1)
    return np.asarray(np.where(front, distance, far_px).clip(0, far_px))


def _blamed(deviations: Mapping[tuple[str, ...], float], limit: float) -> list[tuple[str, ...]]:
    """Return few moved cameras that explain all inconsistent groups of cameras, found greedily.

    An entry with several names means one of these cameras: the points cannot tell which.
    """
    blamed: list[tuple[str, ...]] = []
    left = list(deviations)
    while bad := [group for group in left if deviations[group] > limit]:
        in_bad, in_left = (Counter(chain.from_iterable(groups)) for groups in (bad, left))
        counts = {name: (number / in_left[name], number) for name, number in sorted(in_bad.items())}
        worst_counts = max(counts.values())
        if worst_counts[0] < MIN_BLAME:
            break
        worst = tuple(name for name in counts if counts[name] == worst_counts)
        blamed.append(worst)
        left = [group for group in left if set(worst).isdisjoint(group)]
    return blamed


def _shift(
    views: Mapping[str, View],
    names: tuple[str, ...],
    groups: Groups,
    errors: Mapping[tuple[str, ...], Array],
    blamed: Sequence[tuple[str, ...]],
) -> float:
    """Return a camera's median distance from points that others triangulate, else from epipolar lines, px."""
    (name, *unsure) = names
    guilty = set(chain.from_iterable(blamed)) - {name}
    triples = [group for group in groups if len(group) == 3 and name in group and guilty.isdisjoint(group)]
    distances = []
    for group in () if unsure else triples:
        others = [place for place, camera in enumerate(group) if camera != name]
        first, second = (views[group[place]] for place in others)
        points = triangulate([first, second], groups[group][others])
        clear = angles_deg(points - first.centre, points - second.centre) > MIN_RAY_ANGLE_DEG
        if clear.any():
            at = groups[group][group.index(name)]
            distances.append(reprojection_errors(views[name], points[clear], at[clear]))
    if distances and len(distances_px := np.concatenate(distances)) >= MIN_TRACKS:
        return float(np.median(distances_px))
    concerned = [own_errors for group, own_errors in errors.items() if not set(names).isdisjoint(group)]
    return max(float(np.median(errors_px.sum(0))) for errors_px in concerned)


Views = dict[str, View]


def plainly_fits(views: Views, features: Mapping[str, Features]) -> bool:
    """Return whether every camera's features, including wrong matches, fit those of a neighbour."""
    matched = {(a, b): match_features(features[a], features[b]) for a, b in _neighbours(views, features)}
    groups: Groups = {pair: np.stack(at) for pair, at in matched.items() if len(at[0]) >= MIN_PAIR_POINTS}
    return set().union(*groups) == views.keys() and not _odd(views, groups, _mixed_up_px(views))


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
        # Pairs are searched for among at most twelve cameras: the time grows with their square.
        changes += [
            ({a: now[b], b: now[a]}, ("", f"the calibrations of {a} and {b} are exchanged"))
            for a, b in combinations(names if len(names) <= 12 else (), 2)
        ]
        tried = [(_odd(now | changed, groups, limit), changed, fault) for changed, fault in changes]
        excluded, changed, fault = min(tried, key=lambda trial: len(trial[0]))
        if len(excluded) >= len(left):
            break
        left = excluded
        now |= changed
        faults.append(fault)
    # Other poses may hide a turn of a camera that was moved, within the limit; the right ones fit.
    if not left and not _odd(now, groups, limit * INCONSISTENT_PX / REFUSED_PX):
        return faults
    min_fraction, min_error = OTHER_RIG
    odd = _odd(views, groups, max(_refused_px(views), min_error * max(view.width for view in views.values())))
    text = (
        f"it does not fit the pictures: {len(odd)} of {len(groups)} groups of neighbouring cameras "
        "contradict each other (is it another rig's, or were its cameras moved?)"
    )
    return [("", text)] if len(odd) > min_fraction * len(groups) else []


def _mixed_up_px(views: Views) -> float:
    return _refused_px(views) * min(
        1.0, max((view.width for view in views.values()), default=0) / TYPICAL_WIDTH
    )


def _odd(views: Views, groups: Groups, limit: float) -> list[tuple[str, ...]]:
    return [names for names, at in groups.items() if _deviation_px(_errors_px(views, names, at)) > limit]


def _turned(name: str, views: Views) -> tuple[str, str]:
    # With two cameras it cannot be decided which one is wrong.
    fault, who = ("", " or ".join(views)) if len(views) == 2 else (name, name)
    return fault, f"the pictures of {who} are upside down against the calibration"


def upside_down(view: View) -> View:
    """Return the view of the same camera with its images rotated by 180 degrees."""
    rotation_180 = np.diag([-1.0, -1.0, 1.0])
    matrix = view.matrix.copy()
    matrix[:2, 2] = (view.width - 1, view.height - 1) - matrix[:2, 2]
    return replace(
        view,
        matrix=matrix,
        distortion=view.distortion * (1 if view.is_fisheye else np.array([1, 1, -1, -1, 1])),
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
    errors, angles = [np.zeros(0)], [np.zeros(0)]
    cells: dict[str, set[tuple[int, int]]] = {name: set() for name in views}
    for (a, b), (at_a, at_b) in shared.items():
        if a not in views or b not in views or len(at_a) < MIN_MATCHES:
            continue
        errors.append(_errors_px(views, (a, b), np.stack((at_a, at_b))).max(0))
        rays_a, rays_b = (views[name].rays(at) @ views[name].rotation for name, at in ((a, at_a), (b, at_b)))
        angles.append(angles_deg(rays_a, rays_b))
        for name, at in ((a, at_a), (b, at_b)):
            cells[name] |= grid_cells(at[errors[-1] < INLIER_PX], views[name].width, views[name].height)
    error, angle = np.concatenate(errors), np.concatenate(angles)
    good = error < INLIER_PX
    return CalibrationQuality(
        points=len(good),
        inlier_share=float(good.mean()) if len(good) else 0.0,
        reprojection_error_px=float(np.median(error[good])) if good.any() else None,
        triangulation_angle_deg=float(np.median(angle[good])) if good.any() else None,
        coverage={name: len(own_cells) / math.prod(GRID) for name, own_cells in cells.items()},
    )


def refuse_bad_calibration(quality: CalibrationQuality, cameras: int, advice: str = "") -> None:
    """Raise BadInputError with the reason if a rig's calibration is not fit for measurements.

    `advice` is a further hint.
    """
    error, angle = quality.reprojection_error_px, quality.triangulation_angle_deg
    fraction = f"{100 * quality.inlier_share:.0f} %"
    unjudged = why = ""
    if 2 * len(quality.coverage) < cameras:
        why = f"it covers only {len(quality.coverage)} of {cameras} cameras"
    elif error is None or angle is None:
        unjudged = "no two of its cameras see enough of the same points"
    elif quality.points < MIN_PAIR_POINTS:
        unjudged = f"its cameras share only {quality.points} points; {MIN_PAIR_POINTS} are needed"
    elif quality.inlier_share < MIN_INLIER_FRACTION:
        why = f"only {fraction} of the shared points have a reprojection error below {INLIER_PX:g} px"
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
