"""The backdrop of a moment: what its cameras see beyond all surfaces, by the direction from the subject."""

from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

from reconstruction.common.geometry import Array, View
from reconstruction.depth.seen_moment import Moment, SeenView, find_subject
from reconstruction.depth.view_blending import fill, surface_seen

LOOKED_AT_PX = 240
"""Longer side of the pictures in which the backdrop is looked for."""
MARGIN_PX = 5
"""Side of the neighbourhood without depth that a pixel of the backdrop has, in these pictures."""
MIN_FRACTION = 0.15
"""Fraction of the pictures below which pixels without depth are holes in surfaces, not a backdrop."""
BEYOND = 2.0
"""Radius of the backdrop, relative to the distance of the farthest camera or point from the subject."""
CELLS = 96
"""Number of cells across the narrowest camera's picture."""
MIN_CELLS, MAX_CELLS = 256, 2048
"""Limits of the cells around the whole sphere."""


class Backdrop(NamedTuple):
    """A sphere around the subject, with all cameras inside.

    `colours` (uint8 n x 2n x 3, BGR) are by latitude and longitude: the top row is up (-y), the middle
    column ahead (z).
    """

    centre: Array
    radius: float
    colours: Array


def find_backdrop(moment: Moment) -> Backdrop | None:
    """Return the backdrop that cameras see where no map has depth; None if that is little of the pictures.

    Directions in which no camera sees it have the colours around them.
    """
    small = {camera: seen.resized(LOOKED_AT_PX) for camera, seen in moment.items()}
    empty = {camera: _is_empty(seen, small) for camera, seen in small.items()}
    if np.mean([pixels.mean() for pixels in empty.values()]) < MIN_FRACTION:
        return None
    centre = find_subject(moment)
    distances = [np.array([np.linalg.norm(seen.view.centre - centre) for seen in small.values()])]
    for seen in small.values():
        points = seen.view.unproject_map(seen.depth, seen.depth > 0)
        distances.append(np.percentile(np.linalg.norm(points - centre, axis=1), [99]))
    radius = BEYOND * float(np.concatenate(distances).max())
    narrowest = min(2 * np.arctan(seen.view.width / 2 / seen.view.focal) for seen in small.values())
    height = round(np.clip(2 * np.pi / narrowest * CELLS, MIN_CELLS, MAX_CELLS) / 16) * 8
    sums, counts = np.zeros((2 * height * height, 3)), np.zeros(2 * height * height)
    for camera, seen in small.items():
        rows, columns = np.nonzero(empty[camera])
        pixels = np.column_stack([columns, rows])
        points = seen.view.unproject(pixels, _sphere_depth(seen.view, pixels, centre, radius))
        cells = _cells((points - centre) / radius, height)
        np.add.at(sums, cells, seen.colours[rows, columns])
        np.add.at(counts, cells, 1)
    colours = (sums / np.maximum(counts, 1)[:, None]).astype(np.float32).reshape(height, 2 * height, 3)
    known = (counts > 0).astype(np.float32).reshape(height, 2 * height)
    # The left and the right end are neighbours.
    around = fill(np.tile(colours, (1, 3, 1)), np.tile(known, (1, 3)))
    return Backdrop(centre, radius, around[:, 2 * height : 4 * height])


def add_backdrop(moment: Moment) -> Moment:
    """Return a moment in whose maps the backdrop, if it has one, is a surface."""
    backdrop, added = find_backdrop(moment), dict(moment)
    if backdrop is None:
        return moment
    small = {camera: seen.resized(LOOKED_AT_PX) for camera, seen in moment.items()}
    for camera, seen in moment.items():
        empty = cv2.resize(_is_empty(small[camera], small).astype(np.uint8), seen.depth.shape[::-1])
        rows, columns = np.nonzero((empty > 0) & (seen.depth == 0))
        depth, pixels = seen.depth.copy(), np.column_stack([columns, rows])
        depth[rows, columns] = _sphere_depth(seen.view, pixels, backdrop.centre, backdrop.radius)
        added[camera] = replace(seen, depth=depth)
    return added


def _is_empty(seen: SeenView, moment: Moment) -> Array:
    """Return the pixels (bool) in whose neighbourhood no camera's map has a surface."""
    empty = (seen.depth == 0) & (surface_seen(seen.view, moment) == 0)
    around = np.ones((MARGIN_PX, MARGIN_PX), np.uint8)
    return np.asarray(cv2.erode(empty.astype(np.uint8), around) > 0)


def _sphere_depth(view: View, pixels: Array, centre: Array, radius: float) -> Array:
    """Return the depth (n,) of a sphere at pixels (n, 2) of a view inside it."""
    rays = view.unproject(pixels, np.ones(len(pixels))) - view.centre
    start = view.centre - centre
    # The camera is inside: the sphere is ahead of it once.
    square, slope = (rays**2).sum(axis=1), rays @ start
    return np.asarray((np.sqrt(slope**2 - square * (start @ start - radius**2)) - slope) / square)


def _cells(directions: Array, height: int) -> Array:
    """Return the cells (m,) of unit vectors (m, 3) on the sphere."""
    x, y, z = directions.T
    row = ((np.arcsin(np.clip(y, -1, 1)) / np.pi + 0.5) * height).astype(int).clip(0, height - 1)
    column = ((np.arctan2(x, z) / np.pi + 1) * height).astype(int) % (2 * height)
    return np.asarray(row * 2 * height + column)
