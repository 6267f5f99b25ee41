"""Choice of source views for depth: views of the same points from suitable angles."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from capture_app.common.errors import NotApplicableError
from reconstruction.common.geometry import Array, View
from reconstruction.common.joined_names import joined_to

BEST_ANGLES_DEG = (2.5, 14.0)
"""Best parallax: below the first depth is uncertain; beyond the second a surface begins to look different."""
MIN_ANGLE_DEG = 0.5
"""Minimum parallax: at a focal length of 500 px an error of 0.2 px is 5 % of the depth."""
MAX_ANGLE_DEG = 45.0
"""Maximum parallax; beyond it a surface looks too different to match."""
STEPS = 28
SPACINGS = (0.7, 250.0)
"""Range of depths tried for two views, in units of their distance: parallax of about 70 to 0.2 degrees."""
MIN_FRACTION = 0.05
"""Minimum common fraction of the image; views with less show different scenes."""
MIN_SCORE = 0.12
"""Minimum score of a source; a view that shares less than about 1/8 of the image is not worth its time."""
SPAN_FRACTION = 0.3
"""Minimum common fraction of the image at a depth that is searched."""
MAX_SOURCES = 4


@dataclass(frozen=True)
class ViewOverlap:
    """Overlap of two views over all depths, and its values at the depth where they suit each other best."""

    score: float
    """Fraction of the image that the other sees too, reduced for unsuitable angles; 0 to 1."""
    fraction: float
    angle_deg: float
    typical_score: float
    """Mean score over all depths."""
    span: tuple[float, float]
    """Minimum and maximum inverse depth with enough overlap; (0, 0) if there is none."""


def angle_fitness(angle_deg: Array) -> Array:
    """Return how well surfaces match that two views see at these angles, 0 to 1."""
    low, high = BEST_ANGLES_DEG
    beyond = np.clip((angle_deg - high) / (MAX_ANGLE_DEG - high), 0, 1)
    narrow = np.clip((angle_deg - MIN_ANGLE_DEG) / (low - MIN_ANGLE_DEG), 0, 1)
    return np.asarray(narrow * (1 - beyond) ** 2)


def seen_points(view: View, other: View, points: Array) -> tuple[Array, Array]:
    """Return which points (n, 3) are in another view's image (bool), and the angles between both views."""
    seen = points @ other.rotation.T + other.translation
    ahead = seen[:, 2] > 1e-9
    z = np.where(ahead, seen[:, 2], 1.0)
    x = seen[:, 0] / z * other.matrix[0, 0] + other.matrix[0, 2]
    y = seen[:, 1] / z * other.matrix[1, 1] + other.matrix[1, 2]
    inside = ahead & (x >= 0) & (y >= 0) & (x < other.width) & (y < other.height)
    to_view, to_other = view.centre - points, other.centre - points
    cosine = (to_view * to_other).sum(1)
    cosine /= np.maximum(np.linalg.norm(to_view, axis=1) * np.linalg.norm(to_other, axis=1), 1e-12)
    return inside, np.asarray(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def score_points(view: View, other: View, points: Array) -> float:
    """Return how suitable another view is for the depth of a view's points (n, 3), 0 to 1."""
    inside, angle = seen_points(view, other, points)
    return float(np.mean(inside * angle_fitness(angle))) if len(points) else 0.0


def grid_points(view: View, depth: float) -> Array:
    """Return the points of a grid over the view's image at this depth, in the rig's frame (n, 3)."""
    xs, ys = np.meshgrid(np.linspace(0, view.width - 1, 9), np.linspace(0, view.height - 1, 7))
    pixels = np.column_stack([xs.ravel(), ys.ravel()])
    return view.unproject(pixels, np.full(len(pixels), depth))


def find_overlaps(views: Mapping[str, View], name: str) -> dict[str, ViewOverlap]:
    """Return a view's overlap with every other without knowledge of the scene, from their geometry."""
    view = views[name]
    distances = {other: float(np.linalg.norm(seen.centre - view.centre)) for other, seen in views.items()}
    apart = {other: distance for other, distance in distances.items() if distance > 1e-9}
    if not apart:
        return {}
    depths = np.geomspace(SPACINGS[0] * min(apart.values()), SPACINGS[1] * max(apart.values()), STEPS)
    points = [grid_points(view, float(depth)) for depth in depths]
    return {other: _overlap(view, views[other], depths, points) for other in apart}


def _overlap(view: View, other: View, depths: Array, points: list[Array]) -> ViewOverlap:
    inside, angle = (
        np.array(part) for part in zip(*(seen_points(view, other, p) for p in points), strict=True)
    )
    scores = (inside * angle_fitness(angle)).mean(1)
    fractions = (inside & (angle < MAX_ANGLE_DEG)).mean(1)
    best = int(scores.argmax() if scores.any() else inside.mean(1).argmax())
    enough = np.flatnonzero(fractions >= SPAN_FRACTION)
    span = (0.0, 0.0)
    if len(enough):
        far = 0.0 if enough[-1] == len(depths) - 1 else 1 / float(depths[enough[-1] + 1])
        span = far, 1 / float(depths[max(enough[0] - 1, 0)])
    middle = np.median(angle[best][inside[best]]) if inside[best].any() else angle[best].min()
    return ViewOverlap(
        float(scores[best]), float(inside[best].mean()), float(middle), float(scores.mean()), span
    )


def refuse_views(views: Mapping[str, View], points: Mapping[str, Array] | None = None) -> NotApplicableError:
    """Return the error that says why no two of these views suit depth, from the most suitable two.

    They are judged at the scene's points (n, 3) by camera or, if the scene is unknown, at all depths.
    """
    if points is None:
        pairs = {
            (name, other): (overlap.score, overlap.fraction, overlap.angle_deg)
            for name in views
            for other, overlap in find_overlaps(views, name).items()
        }
    else:
        pairs = {
            (a, b): _measured(views[a], views[b], points[a])
            for a, b in permutations(views, 2)
            if len(points.get(a, ()))
        }
    if not pairs:
        return NotApplicableError(
            "all cameras are at one place, from which no depth can be measured",
            hint="move them apart, or check the calibration",
        )
    # If no two are suitable, take those with the most overlap, from the most similar directions.
    a, b = max(pairs, key=lambda pair: (pairs[pair][0], round(pairs[pair][1], 1), -pairs[pair][2]))
    _, fraction, angle = pairs[a, b]
    written = f"{angle:.1f}" if angle < 10 else f"{angle:.0f}"
    seen = f"{a} and {b} share {100 * fraction:.0f} % of the picture and see it {written} degrees apart"
    low, high = BEST_ANGLES_DEG
    fit = f"{low:g} to {high:g} degrees apart as seen from there"
    if angle > high and fraction > MIN_FRACTION:
        return NotApplicableError(
            f"the cameras are too far apart: at best, {seen}",
            hint=f"put them, or others between them, {fit}; {MAX_ANGLE_DEG:g} is too much",
        )
    if fraction < SPAN_FRACTION:
        return NotApplicableError(
            f"no camera sees what another sees: at best, {seen}",
            hint="point the cameras at the same scene, or check the calibration",
        )
    return NotApplicableError(
        f"the cameras are too close together, or the scene is too far away: at best, {seen}",
        hint=f"put them {fit}, or go nearer",
    )


def _measured(view: View, other: View, points: Array) -> tuple[float, float, float]:
    """Return score, common image fraction and median angle at the middle depth of a view's points (n, 3)."""
    depth = float(np.median((points @ view.rotation.T + view.translation)[:, 2]))
    inside, angle = seen_points(view, other, grid_points(view, depth))
    middle = np.median(angle[inside] if inside.any() else angle)
    return score_points(view, other, points), float(inside.mean()), float(middle)


def choose_source_views(
    views: Mapping[str, View], points: Mapping[str, Array], steps_ns: Mapping[str, int] | None = None
) -> dict[str, tuple[str, ...]]:
    """Return, for every camera, the others to match it with, best first; none without overlap.

    They are judged at points (n, 3) that each camera sees: the fraction in the other's image, weighted by the
    angle between the two views of each point. With `steps_ns`, only cameras of equal steps are matched.
    """
    chosen = {}
    for name, view in views.items():
        others = [o for o in views if o != name and (steps_ns is None or steps_ns[o] == steps_ns[name])]
        scores = {other: score_points(view, views[other], points[name]) for other in others}
        suitable = (other for other in scores if scores[other] >= MIN_SCORE)
        chosen[name] = tuple(sorted(suitable, key=lambda other: (-scores[other], other))[:MAX_SOURCES])
    # A source must be matched too so that it can confirm; overlap is mutual, so this hardly ever applies.
    while any(not chosen[other] for others in chosen.values() for other in others):
        chosen = {name: tuple(o for o in others if chosen[o]) for name, others in chosen.items()}
    return chosen


def choose_reference_view(views: Mapping[str, View], points: Mapping[str, Array]) -> str:
    """Return the most central of the cameras whose points (n, 3) the other cameras see best."""
    shared = {}
    for name, view in views.items():
        others = [seen for other, seen in views.items() if other != name]
        seen = [seen_points(view, other, points[name])[0].mean() for other in others if len(points[name])]
        shared[name] = float(np.mean(seen)) if seen else 0.0
    enough = 0.9 * max(shared.values())
    middle = np.mean([view.centre for view in views.values()], axis=0)
    distances = {name: round(float(np.linalg.norm(view.centre - middle)), 6) for name, view in views.items()}
    return min((name for name in views if shared[name] >= enough), key=lambda name: (distances[name], name))


def smallest_group(sources: Mapping[str, Sequence[str]]) -> int:
    """Return the size of the smallest group of cameras connected by source links.

    Two opposite pairs are groups of two: none of their points is in more than two maps.
    """
    linked = [name for name, others in sources.items() if others]
    links = [(name, other) for name in linked for other in sources[name] if other in linked]
    return min((len(joined_to(name, links)) for name in linked), default=0)
