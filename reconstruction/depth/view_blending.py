"""A new view of a moment: the pictures of its cameras, blended through their depth maps.

The surface is the nearest one on which two maps agree. Each of its pixels takes its colour from the cameras
that see it, those of a similar direction first (Buehler et al. 2001, Unstructured lumigraph rendering).
"""

import ctypes
from typing import NamedTuple

import cv2
import numpy as np

from reconstruction.common.geometry import Array, View, other_from_reference
from reconstruction.common.worker_pool import worker_pool
from reconstruction.depth.compiling import VIEWS
from reconstruction.depth.kernels import call_kernel, floats
from reconstruction.depth.seen_moment import Moment, SeenView

TOLERANCE = 0.015
"""Relative difference of depth within which two maps show one surface."""
SCALE = 0.08
"""Angle between two directions, radians, at which a camera's weight is 1/e."""
UNSURE = 0.1
"""Weight of a camera whose own map has no depth at the surface."""
BAND_ROWS = 60


class Rendered(NamedTuple):
    """A new view: `colours` uint8 height x width x 3, BGR; `depth` float32, 0 = no camera saw anything there.

    `known` (bool) marks pixels that a camera saw; the others' colours are filled from around them.
    """

    colours: Array
    depth: Array
    known: Array


class _SeenFrom(ctypes.Structure):
    _fields_ = (
        ("colours", ctypes.c_void_p),
        ("depth", ctypes.c_void_p),
        ("width", ctypes.c_int),
        ("height", ctypes.c_int),
        ("to", ctypes.c_float * 12),
        ("centre", ctypes.c_float * 3),
    )


def render(view: View, moment: Moment) -> Rendered:
    """Return what a view without distortion sees of a moment."""
    height, width = view.height, view.width
    depth = surface_seen(view, moment)
    rays = floats(np.array([*view.matrix[[0, 1], [0, 1]], *view.matrix[:2, 2]]))
    colours, weights = np.empty((height, width, 3), np.float32), np.empty((height, width), np.float32)
    held = [(np.ascontiguousarray(seen.colours), floats(seen.depth)) for seen in moment.values()]
    sources = (_SeenFrom * len(held))(
        *(_seen_from(view, *pair) for pair in zip(moment.values(), held, strict=True))
    )
    scalars = ctypes.c_float(TOLERANCE), ctypes.c_float(1 / SCALE**2), ctypes.c_float(UNSURE)

    def band(top: int) -> None:
        rows = top, min(top + BAND_ROWS, height)
        call_kernel(
            "blend_views",
            *(len(held), sources, width, *rows, depth, rays, *scalars, colours, weights),
            source=VIEWS,
        )

    with worker_pool() as pool:
        list(pool.map(band, range(0, height, BAND_ROWS)))
    known = weights > 0
    depth = np.where(known, depth, 0)
    return Rendered(fill(colours, depth), depth, known)


def surface_seen(view: View, moment: Moment) -> Array:
    """Return the depth of the surface that a view sees, float32 height x width, 0 = unknown."""
    layers = np.empty((len(moment), view.height, view.width), np.float32)
    weights = np.empty(len(moment), np.float32)

    def layer(number: int, seen: SeenView) -> None:
        to = _pixels_to_pixels(seen.view, view)
        zoom = ctypes.c_float(view.focal / seen.view.focal)
        shape = *seen.depth.shape, floats(seen.depth), floats(to), zoom, view.height, view.width
        call_kernel("nearest_depth", *shape, layers[number], source=VIEWS)
        apart = float(np.linalg.norm(seen.view.centre - view.centre))
        weights[number] = 1 / (1e-6 + apart**2)

    with worker_pool() as pool:
        list(pool.map(layer, range(len(moment)), moment.values()))
    depth = np.empty((view.height, view.width), np.float32)
    pixels = ctypes.c_long(depth.size)
    call_kernel(
        "agreed_depth", len(moment), pixels, layers, weights, ctypes.c_float(TOLERANCE), depth, source=VIEWS
    )
    return depth


def fill(colours: Array, depth: Array) -> Array:
    """Return colours (float32 height x width x 3) as uint8, filled from around where `depth` is 0.

    Means of ever larger neighbourhoods fill what smaller ones leave (pull-push: Gortler et al. 1996). What is
    far counts more: a hole is what something near hid from the cameras.
    """
    # Where others are filled, far pixels count by this power of their depth.
    weight = ((depth / max(float(depth.max()), 1e-9)) ** 4).astype(np.float32)
    levels = [(colours * weight[..., None], weight)]
    while min(levels[-1][1].shape) > 4:
        levels.append((cv2.pyrDown(levels[-1][0]), cv2.pyrDown(levels[-1][1])))
    sums, weights = levels[-1]
    filled = sums / np.maximum(weights, 1e-6)[..., None]
    for sums, weights in levels[-2::-1]:
        around = cv2.pyrUp(filled, dstsize=sums.shape[1::-1])
        fraction = (weights / np.maximum(weights, 0.05))[..., None]
        filled = fraction * sums / np.maximum(weights, 1e-6)[..., None] + (1 - fraction) * around
    filled = np.where(depth[..., None] > 0, colours, filled)
    return np.asarray(np.clip(np.rint(filled), 0, 255), np.uint8)


def _seen_from(view: View, seen: SeenView, held: tuple[Array, Array]) -> _SeenFrom:
    to = (ctypes.c_float * 12)(*_pixels_to_pixels(view, seen.view))
    centre = (ctypes.c_float * 3)(*(view.rotation @ seen.view.centre + view.translation))
    return _SeenFrom(held[0].ctypes.data, held[1].ctypes.data, seen.view.width, seen.view.height, to, centre)


def _pixels_to_pixels(first: View, second: View) -> Array:
    """Return what maps a pixel times its depth from one view to another: 3 x 3, then the shift, (12,)."""
    rotation, translation = other_from_reference(first, second)
    homography = second.matrix @ rotation @ np.linalg.inv(first.matrix)
    return np.array([*homography.ravel(), *(second.matrix @ translation)])
