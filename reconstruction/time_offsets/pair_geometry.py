"""Epipolar geometry of two views, and the effect of calibration errors on it."""

from dataclasses import replace

import numpy as np

from reconstruction.common.geometry import Array, View, other_from_reference

ODDS_PX = (1.0, 0.5, 0.3, 0.15)
"""Standard deviations of a calibration's smooth image errors, px: terms of degree 0, 1, 2 and 3 in the
position in the image."""
DIRECTION = 3e-3
"""Standard deviation of the direction from one camera to the other, rad."""
TERMS = 12


def epipolar_errors_px(a: View, b: View, at_a: Array, at_b: Array) -> Array:
    """Return the signed distances (n,) of matched pixels (n, 2) from the epipolar geometry of two views, px.

    To first order (Sampson 1982; Hartley and Zisserman, 2nd edition, section 11.4.3). The views must be at
    different places.
    """
    rotation, translation = other_from_reference(a, b)
    x, y, z = translation / np.linalg.norm(translation)
    essential = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ rotation
    rays_a, rays_b = a.rays(at_a), b.rays(at_b)
    lines_b, lines_a = rays_a @ essential.T, rays_b @ essential
    steepness = np.sqrt((lines_b[:, :2] ** 2).sum(1) / b.focal**2 + (lines_a[:, :2] ** 2).sum(1) / a.focal**2)
    return np.asarray((rays_b * lines_b).sum(1) / np.maximum(steepness, 1e-12))


def geometry_terms(a: View, b: View, at_a: Array, at_b: Array) -> Array:
    """Return what one standard deviation of each calibration error adds to `epipolar_errors_px`, (n, TERMS).

    Errors of rotation, lens and distortion shift image points smoothly over the image, at any depth. An error
    of the direction between the cameras shifts them by depth, as a delay does with a moving camera.
    """
    x, y = (2 * at_a[:, i] / size - 1 for i, size in enumerate((a.width, a.height)))
    smooth = [
        odds * x ** (degree - down) * y**down
        for degree, odds in enumerate(ODDS_PX)
        for down in range(degree + 1)
    ]
    apart = b.centre - a.centre
    distance = float(np.linalg.norm(apart))
    now = epipolar_errors_px(a, b, at_a, at_b)
    aside = [
        epipolar_errors_px(a, _moved(b, distance * DIRECTION * beside), at_a, at_b) - now
        for beside in np.linalg.svd(apart[None] / distance)[2][1:]
    ]
    return np.column_stack([*smooth, *aside])


def places(geometry: Array) -> Array:
    """Return the image positions (n, 2) that belong to the terms, from -1 to 1 across and down."""
    return np.asarray(geometry[:, 1:3] / ODDS_PX[1])


def _moved(view: View, by: Array) -> View:
    return replace(view, translation=view.translation - view.rotation @ by)
