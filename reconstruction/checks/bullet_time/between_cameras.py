"""Views between the cameras of a bullet-time sweep, blended through the depth of all of them."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise

import numpy as np

from reconstruction.common.geometry import Array, View
from reconstruction.depth.view_blending import render
from reconstruction.method.moments import see_moments
from reconstruction.scene.conditions import Condition
from reconstruction.scene.scene import Scene


def film_between(
    scene: Scene,
    instant: int,
    condition: Condition,
    stabilized: Mapping[str, View],
    pictures: Sequence[Array],
    number: int,
) -> list[Array]:
    """Return the pictures of a sweep's stabilized views, with `number` views between neighbours.

    Raises as `see_moments` does.
    """
    (seen,) = see_moments(scene, [instant], condition, quick=True)
    film = [pictures[0]]
    for (left, right), picture in zip(pairwise(stabilized.values()), pictures[1:], strict=True):
        film += [render(view, seen.moment).colours for view in views_between(left, right, number)]
        film.append(picture)
    return film


def views_between(left: View, right: View, number: int) -> Iterator[View]:
    """Yield views at equal steps from one view to another of the same size, without these."""
    for share in np.linspace(0, 1, number + 2)[1:-1]:
        mean = (1 - share) * left.rotation + share * right.rotation
        u, _, v = np.linalg.svd(mean)
        centre = (1 - share) * left.centre + share * right.centre
        matrix = (1 - share) * left.matrix + share * right.matrix
        yield View(left.width, left.height, matrix, np.zeros(5), u @ v, -(u @ v) @ centre)
