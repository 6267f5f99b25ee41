"""Which views suit each other for depth: those that see the same points from fit directions."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from capture_app.common.errors import NotApplicableError
from reconstruction.common.geometry import Array, View

BEST_ANGLES_DEG = (2.5, 14.0)
"""Below this parallax depth is uncertain; beyond it the same surface begins to look different."""
MIN_ANGLE_DEG = 0.5
"""Below this it says nothing: at a focal length of 500 px an error of 0.2 px is 5 % of the depth."""
MAX_ANGLE_DEG = 45.0
"""Beyond this it looks so different that nothing is matched."""
STEPS = 28
SPACINGS = (0.7, 250.0)
"""Depths that are tried for two views, in distances between them: parallax of about 70 to 0.2 degrees."""
MIN_SHARE = 0.05
"""Views that share less show different things."""
MIN_SCORE = 0.12
"""A view that shares less than about an eighth of the picture is not worth its time."""
SPAN_SHARE = 0.3
"""Depths at which two views share less of the picture are not searched."""
MAX_SOURCES = 4


@dataclass(frozen=True)
class ViewOverlap:
    """What a view shares with another; all but the span at the depth where they suit each other best."""

    score: float
    """Share of the picture that the other sees too, less where the angle is unfit; 0 to 1."""
    share: float
    angle_deg: float
    usual_score: float
    """Mean of the score over all depths."""
    span: tuple[float, float]
    """Least and greatest inverse depth at which enough is shared; (0, 0) where it never is."""


def angle_fitness(angle_deg: Array) -> Array:
    """How well surfaces match that two views see at these angles, 0 to 1."""
    low, high = BEST_ANGLES_DEG
    beyond = np.clip((angle_deg - high) / (MAX_ANGLE_DEG - high), 0, 1)
    narrow = np.clip((angle_deg - MIN_ANGLE_DEG) / (low - MIN_ANGLE_DEG), 0, 1)
    return np.asarray(narrow * (1 - beyond) ** 2)


def seen_points(view: View, other: View, points: Array) -> tuple[Array, Array]:
    """Which points (n, 3) another view's picture holds (bool), and between which angles both see them."""
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
    """How well another view suits for the depth of a view's points (n, 3), 0 to 1."""
    inside, angle = seen_points(view, other, points)
    return float(np.mean(inside * angle_fitness(angle))) if len(points) else 0.0


def grid_points(view: View, depth: float) -> Array:
    """Points of a grid over the view's picture at this depth, in the rig's frame (n, 3)."""
    xs, ys = np.meshgrid(np.linspace(0, view.width - 1, 9), np.linspace(0, view.height - 1, 7))
    pixels = np.column_stack([xs.ravel(), ys.ravel()])
    return view.unproject(pixels, np.full(len(pixels), depth))


def find_overlaps(views: Mapping[str, View], name: str) -> dict[str, ViewOverlap]:
    """What a view shares with every other, where nothing is known of the scene: by where their cones meet."""
    view = views[name]
    away = {
        other: float(np.linalg.norm(seen.centre - view.centre))
        for other, seen in views.items()
        if other != name
    }
    apart = [distance for distance in away.values() if distance > 1e-9]
    if not apart:
        return {}
    depths = np.geomspace(SPACINGS[0] * min(apart), SPACINGS[1] * max(apart), STEPS)
    points = [grid_points(view, float(depth)) for depth in depths]
    return {other: _overlap(view, views[other], depths, points) for other in away if away[other] > 1e-9}


def _overlap(view: View, other: View, depths: Array, points: list[Array]) -> ViewOverlap:
    inside, angle = (
        np.array(part) for part in zip(*(seen_points(view, other, p) for p in points), strict=True)
    )
    scores = (inside * angle_fitness(angle)).mean(1)
    shares = (inside & (angle < MAX_ANGLE_DEG)).mean(1)
    best = int(scores.argmax() if scores.any() else inside.mean(1).argmax())
    enough = np.flatnonzero(shares >= SPAN_SHARE)
    span = (0.0, 0.0)
    if len(enough):
        far = 0.0 if enough[-1] == len(depths) - 1 else 1 / float(depths[enough[-1] + 1])
        span = far, 1 / float(depths[max(enough[0] - 1, 0)])
    middle = np.median(angle[best][inside[best]]) if inside[best].any() else angle[best].min()
    return ViewOverlap(
        float(scores[best]), float(inside[best].mean()), float(middle), float(scores.mean()), span
    )


def refuse_views(views: Mapping[str, View], points: Mapping[str, Array] | None = None) -> NotApplicableError:
    """Why no two of these views are fit for depth, by the two that come nearest to it.

    Judged at the scene's points (n, 3) by the camera that sees them, or where nothing is known of it at all
    depths.
    """
    if points is None:
        pairs = {
            (name, other): (overlap.score, overlap.share, overlap.angle_deg)
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
            "all cameras are in one place: nothing tells near from far",
            hint="move them apart, or check the calibration",
        )
    # Where no two are fit, those that share most of their pictures, from the least different directions.
    a, b = max(pairs, key=lambda pair: (pairs[pair][0], round(pairs[pair][1], 1), -pairs[pair][2]))
    _, share, angle = pairs[a, b]
    written = f"{angle:.1f}" if angle < 10 else f"{angle:.0f}"
    seen = f"{a} and {b} share {100 * share:.0f} % of the picture and see it {written} degrees apart"
    low, high = BEST_ANGLES_DEG
    fit = f"{low:g} to {high:g} degrees apart as seen from there"
    if angle > high and share > MIN_SHARE:
        return NotApplicableError(
            f"the cameras are too far apart: at best, {seen}",
            hint=f"put them, or others between them, {fit}; {MAX_ANGLE_DEG:g} is too much",
        )
    if share < SPAN_SHARE:
        return NotApplicableError(
            f"no camera sees what another sees: at best, {seen}",
            hint="turn the cameras to the same scene, or check the calibration",
        )
    return NotApplicableError(
        f"the cameras are too close together, or the scene is too far away: at best, {seen}",
        hint=f"put them {fit}, or go nearer",
    )


def _measured(view: View, other: View, points: Array) -> tuple[float, float, float]:
    """Score, shared part of the picture and median angle at the middle depth of a view's points (n, 3)."""
    depth = float(np.median((points @ view.rotation.T + view.translation)[:, 2]))
    inside, angle = seen_points(view, other, grid_points(view, depth))
    middle = float(np.median(angle[inside] if inside.any() else angle))
    return score_points(view, other, points), float(inside.mean()), middle


def choose_source_views(views: Mapping[str, View], points: Mapping[str, Array]) -> dict[str, tuple[str, ...]]:
    """For every camera the others to match it with, best first; none where nothing is shared.

    Judged at points (n, 3) of what each camera sees: the share that the other's picture holds, weighed by
    the angle between the two views of each.
    """
    chosen = {}
    for name, view in views.items():
        scores = {o: score_points(view, seen, points[name]) for o, seen in views.items() if o != name}
        ranked = sorted(scores, key=lambda other: (-scores[other], other))
        chosen[name] = tuple(other for other in ranked[:MAX_SOURCES] if scores[other] >= MIN_SCORE)
    # A source must be matched too, for its depth to confirm; sharing is mutual, so this hardly ever binds.
    while any(not chosen[other] for others in chosen.values() for other in others):
        chosen = {name: tuple(o for o in others if chosen[o]) for name, others in chosen.items()}
    return chosen


def choose_reference_view(views: Mapping[str, View], points: Mapping[str, Array]) -> str:
    """The camera in the middle of the rig among those whose points (n, 3) the others see most of."""
    shared = {}
    for name, view in views.items():
        others = [seen for other, seen in views.items() if other != name]
        seen = [seen_points(view, other, points[name])[0].mean() for other in others if len(points[name])]
        shared[name] = float(np.mean(seen)) if seen else 0.0
    enough = 0.9 * max(shared.values())
    middle = np.mean([view.centre for view in views.values()], axis=0)
    away = {name: round(float(np.linalg.norm(view.centre - middle)), 6) for name, view in views.items()}
    return min((name for name in views if shared[name] >= enough), key=lambda name: (away[name], name))


def smallest_group(sources: Mapping[str, Sequence[str]]) -> int:
    """How many cameras the smallest group has whose views are each other's sources, over any number of steps.

    Two opposite pairs are groups of two: no point of theirs is in more maps.
    """
    left = {name for name, others in sources.items() if others}
    sizes = []
    while left:
        group = {left.pop()}
        while linked := {o for o in left if group & {*sources[o]} or any(o in sources[one] for one in group)}:
            group |= linked
            left -= linked
        sizes.append(len(group))
    return min(sizes, default=0)
