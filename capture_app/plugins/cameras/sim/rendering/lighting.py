"""The studio's light: sun through a tall window behind the cameras, and soft light from sky and room.

Directions point from a surface to the light; colours are linear BGR.
"""

import functools

import numpy as np

from capture_app.plugins.cameras.sim.scenes.stages import Floats

_TO_SUN = np.array([-0.60, -0.44, -0.66])
TO_SUN: Floats = (_TO_SUN / np.linalg.norm(_TO_SUN)).astype(np.float32)
SUN = np.array([0.62, 0.84, 1.0], np.float32) * 2.7

_TO_WINDOW = np.array([-0.70, -0.42, -0.58], np.float32)
TO_WINDOW: Floats = _TO_WINDOW / np.linalg.norm(_TO_WINDOW)

# Two directions across the sun's rays: the window's own axes, projected along its light.
_ACROSS = np.cross(TO_SUN, [0.0, 1.0, 0.0]).astype(np.float32)
ACROSS: Floats = _ACROSS / np.linalg.norm(_ACROSS)
ALONG: Floats = np.cross(TO_SUN, ACROSS).astype(np.float32)
SUN_PLANE: Floats = np.stack([ACROSS, ALONG])

WINDOW = (-3.40, -0.70, -0.40, 2.20)
"""Lit part of the sun's rays, in m along ACROSS (from, to) and ALONG (from, to)."""
BARS = (3, 3)
"""Number of panes across and along, with bars between them."""
_SKY_STEPS = 24
"""Steps of each axis of the normals for which the sky's light is known."""


def sky_radiance(directions: Floats) -> Floats:
    """Return the radiance (N, 3) of the surroundings in unit directions (N, 3)."""
    up = -directions[:, 1:2]
    window, ceiling, floor = np.array(
        [[1.30, 1.16, 1.06], [0.34, 0.34, 0.35], [0.10, 0.15, 0.22]], np.float32
    )
    facing_window = np.maximum(directions @ TO_WINDOW, 0.0)[:, None] ** 3
    light = 0.15 + facing_window * window + np.maximum(up, 0.0) * ceiling + np.maximum(-up, 0.0) * floor
    return np.asarray(light, np.float32)


def window_fraction(points: Floats) -> Floats:
    """Return the fraction (N) of the sun's disc that the window lets through to points (N, 3) in m."""
    a, b = SUN_PLANE @ points.T
    left, right, top, bottom = WINDOW
    lit = _inside(a, left, right) * _inside(b, top, bottom)
    for values, start, end, panes in ((a, left, right, BARS[0]), (b, top, bottom, BARS[1])):
        for number in range(1, panes):
            middle = start + (end - start) * number / panes
            lit *= 1 - 0.88 * _inside(values, middle - 0.028, middle + 0.028)
    return np.asarray(lit, np.float32)


def _inside(values: Floats, start: float, end: float, blur: float = 0.02) -> Floats:
    return np.asarray(
        np.clip((values - start) / blur + 0.5, 0, 1) * np.clip((end - values) / blur + 0.5, 0, 1), np.float32
    )


def cosine_directions(count: int) -> Floats:
    """Return directions (count, 3) about +z, with cosine density and even spacing."""
    number = np.arange(count) + 0.5
    radius = np.sqrt(number / count)
    angle = 2 * np.pi * (number * 0.618034)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - radius**2)], -1).astype(
        np.float32
    )


@functools.cache
def _open_sky() -> Floats:
    """Return the light from the sky on unshadowed surfaces (n, n, n, 3), by the axes of their normals."""
    axis = np.linspace(-1, 1, _SKY_STEPS, dtype=np.float32)
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    normals = grid / np.maximum(np.linalg.norm(grid, axis=1, keepdims=True), 1e-6)
    total = np.zeros_like(normals)
    tangent, bitangent = tangents(normals)
    local = cosine_directions(64)
    for x, y, z in local:
        total += sky_radiance(x * tangent + y * bitangent + z * normals)
    return np.asarray(total / len(local), np.float32).reshape(_SKY_STEPS, _SKY_STEPS, _SKY_STEPS, 3)


def sky_irradiance(normals: Floats) -> Floats:
    """Return the cosine-weighted mean radiance (N, 3) of the open sky over the hemisphere of unit normals."""
    index = np.rint((normals + 1) * ((_SKY_STEPS - 1) / 2)).astype(np.int32)
    return np.asarray(_open_sky()[index[:, 0], index[:, 1], index[:, 2]], np.float32)


def tangents(normals: Floats) -> tuple[Floats, Floats]:
    """Return two sets of unit vectors (N, 3), orthogonal to the normals and to each other."""
    helper = np.where(
        np.abs(normals[:, 1:2]) < 0.9, np.array([0, 1, 0], np.float32), np.array([1, 0, 0], np.float32)
    )
    tangent = np.cross(helper, normals)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-6)
    return tangent.astype(np.float32), np.cross(normals, tangent).astype(np.float32)


def sun_direction(number: int, count: int) -> Floats:
    """Return the direction (3) to one of `count` points distributed over the sun's disc."""
    # Radians, with its haze: it sets how shadows soften with distance.
    radius = 0.012 * np.sqrt((number + 0.5) / count)
    angle = 2 * np.pi * 0.618034 * number
    towards = TO_SUN + radius * (np.cos(angle) * ACROSS + np.sin(angle) * ALONG)
    return np.asarray(towards / np.linalg.norm(towards), np.float32)
