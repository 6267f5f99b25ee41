"""The choice of each camera's source views: those that see the same points from fit directions."""

from collections.abc import Mapping, Sequence

import numpy as np

from reconstruction.common.geometry import Array, View
from reconstruction.depth.view_overlap import MIN_SCORE, score_points, seen_points

MAX_SOURCES = 4


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
