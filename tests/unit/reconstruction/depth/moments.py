"""A moment that is known exactly: a painted wall and a board before it, as pinholes see them."""

from typing import Any

import cv2
import numpy as np

from reconstruction.common.geometry import Array, View
from reconstruction.depth.seen_moment import Moment, SeenView

WIDTH, HEIGHT, FOCAL = 120, 90, 110.0
WALL_M, BOARD_M = 3.0, 2.0
BOARD = (-0.25, -0.2, 0.25, 0.2)
"""Left, top, right and bottom of the board, m."""
TEXELS = 60.0
"""Texture pixels a metre."""


def texture(seed: int) -> Array:
    """A smooth texture of colours, 8 m wide and high."""
    noise = np.random.default_rng(seed).integers(0, 256, (480, 480, 3)).astype(np.float32)
    return cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 5), None, 0, 255, cv2.NORM_MINMAX)


WALL_PAINT, BOARD_PAINT = texture(1), texture(2)


def view_at(x: float, y: float = 0.0, z: float = 0.0, turn: float = 0.0) -> View:
    """A camera at a place, turned about its vertical axis (radians)."""
    rotation = cv2.Rodrigues(np.array([0.0, turn, 0.0]))[0]
    matrix = np.array([[FOCAL, 0, (WIDTH - 1) / 2], [0, FOCAL, (HEIGHT - 1) / 2], [0, 0, 1.0]])
    return View(WIDTH, HEIGHT, matrix, np.zeros(5), rotation, -rotation @ np.array([x, y, z]))


def seen(view: View) -> SeenView:
    """What a camera sees of the wall and the board: colours, depth and normals."""
    rays = view.rays(view.grid())
    world = rays @ view.rotation
    colours, depth = np.zeros((len(rays), 3), np.float32), np.zeros(len(rays))
    for plane, paint, box in ((WALL_M, WALL_PAINT, None), (BOARD_M, BOARD_PAINT, BOARD)):
        distance = (plane - view.centre[2]) / world[:, 2]
        points = view.centre + world * distance[:, None]
        inside = np.ones(len(rays), bool)
        if box is not None:
            inside = (points[:, :2] > box[:2]).all(1) & (points[:, :2] < box[2:]).all(1)
        at = (points[:, :2] * TEXELS + 240).astype(np.float32)
        painted = cv2.remap(paint, at[None, :, 0], at[None, :, 1], cv2.INTER_LINEAR)[0]
        colours[inside], depth[inside] = painted[inside], distance[inside]
    shape = view.height, view.width
    normals = np.broadcast_to(view.rotation @ [0, 0, -1.0], (*shape, 3)).astype(np.float32)
    picture = np.rint(colours).astype(np.uint8).reshape(*shape, 3)
    return SeenView(view, picture, depth.astype(np.float32).reshape(shape), normals)


def moment(**places: Any) -> Moment:
    """Three cameras half a metre apart, or those at `places`, by name."""
    views = {name: view_at(*place) for name, place in places.items()}
    views = views or {"left": view_at(-0.25), "middle": view_at(0.0, 0.05), "right": view_at(0.25)}
    return {name: seen(view) for name, view in views.items()}
