"""The choice of each camera's source views: those that see the same from another place."""

from collections.abc import Mapping, Sequence

import numpy as np

from reconstruction.common.geometry import Array, View

MAX_SOURCES = 4
MIN_SCORE = 0.12
"""A source with less than about an eighth of the picture in common is not worth its time."""
MIN_ANGLE_DEG = 2.5
"""Below this parallax depth is uncertain."""
MAX_ANGLE_DEG = 14.0
"""Beyond this the same surface begins to look different."""


def choose_source_views(views: Mapping[str, View], depths: Sequence[float]) -> dict[str, tuple[str, ...]]:
    """For every camera the others to match it with, best first; none where nothing is shared.

    Judged at points of its picture at these depths (the rig's unit): the share that the other sees,
    times a factor that is largest for `MIN_ANGLE_DEG` to `MAX_ANGLE_DEG` of parallax.
    """
    chosen = {}
    for name, view in views.items():
        scores = {
            other: max(score_source_view(view, seen, depth) for depth in depths)
            for other, seen in views.items()
            if other != name
        }
        ranked = sorted(scores, key=lambda other: (-scores[other], other))
        chosen[name] = tuple(other for other in ranked[:MAX_SOURCES] if scores[other] >= MIN_SCORE)
    return chosen


def choose_reference_view(views: Mapping[str, View], depths: Sequence[float]) -> str:
    """The camera in the middle of the rig among those whose pictures the others share most of."""
    shared = {}
    for name, view in views.items():
        others = [other for other in views if other != name]
        seen = [_visible_grid(view, views[other], depth)[0].mean() for other in others for depth in depths]
        shared[name] = float(np.mean(seen)) if seen else 0.0
    enough = 0.9 * max(shared.values())
    middle = np.mean([view.centre for view in views.values()], axis=0)
    away = {name: round(float(np.linalg.norm(view.centre - middle)), 6) for name, view in views.items()}
    return min((name for name in views if shared[name] >= enough), key=lambda name: (away[name], name))


def score_source_view(view: View, other: View, depth: float) -> float:
    """How well another view suits as a source of this one for a scene at this depth; 0 to 1."""
    inside, points = _visible_grid(view, other, depth)
    to_view, to_other = view.centre - points, other.centre - points
    cosine = (to_view * to_other).sum(1)
    cosine /= np.maximum(np.linalg.norm(to_view, axis=1) * np.linalg.norm(to_other, axis=1), 1e-12)
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    fit = np.minimum(angle / MIN_ANGLE_DEG, 1.0)
    fit *= np.exp(-((np.maximum(angle - MAX_ANGLE_DEG, 0) / 10.0) ** 2))
    return float(np.mean(inside * fit))


def _visible_grid(view: View, other: View, depth: float) -> tuple[Array, Array]:
    """Which of a view's points at this depth the other sees (n), and the points (n, 3)."""
    points = _points(view, depth)
    seen = points @ other.rotation.T + other.translation
    ahead = seen[:, 2] > 1e-9
    z = np.where(ahead, seen[:, 2], 1.0)
    x = seen[:, 0] / z * other.matrix[0, 0] + other.matrix[0, 2]
    y = seen[:, 1] / z * other.matrix[1, 1] + other.matrix[1, 2]
    return ahead & (x >= 0) & (y >= 0) & (x < other.width) & (y < other.height), points


def sample_depths(nearest: float, farthest: float) -> tuple[float, float, float]:
    """The two ends of a depth range, and the depth that is in their middle in a picture."""
    return nearest, 2 / (1 / nearest + 1 / farthest), farthest


def guess_depths(views: Mapping[str, View]) -> tuple[float, ...]:
    """Depths to try before the scene is known: multiples of the distance between neighbouring cameras."""
    centres = np.array([view.centre for view in views.values()])
    distance = np.linalg.norm(centres[:, None] - centres[None], axis=2)
    distance[distance <= 1e-9] = np.inf
    nearest = distance.min(1)
    usual = float(np.median(nearest[np.isfinite(nearest)])) if np.isfinite(nearest).any() else 0.0
    return tuple(usual * times for times in (4.0, 8.0, 16.0, 32.0))


def _points(view: View, depth: float) -> Array:
    """Points of a grid over the view's picture at this depth, in the rig's frame (n, 3)."""
    xs, ys = np.meshgrid(np.linspace(0, view.width - 1, 9), np.linspace(0, view.height - 1, 7))
    pixels = np.column_stack([xs.ravel(), ys.ravel()])
    return view.unproject(pixels, np.full(len(pixels), depth))
